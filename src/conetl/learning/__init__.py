"""Teach the detector an operator's own images: labels out of a map and from other tools, training, evidence, comparison.

It imports `pipeline` and everything below it. PyTorch is imported by `network`, `loss` and what uses them, and only when
`conetl train` runs. `training/`, which made the shipped network, uses the same modules. Start with `fine_tuning.py`.
"""
