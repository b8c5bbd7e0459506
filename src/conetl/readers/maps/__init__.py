"""Maps made elsewhere: files -> checked statements. The story begins in `statements.py`."""
