"""What people do with a map besides ingesting drives: decide, import maps and base layers, derive work zones.

It imports the rest of `pipeline` and what that may import. Start with `decisions.py`.
"""
