"""Processes that outlive the command that started them.

It imports `model` only. The story begins in `processes.py`.
"""
