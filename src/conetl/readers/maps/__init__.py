"""Maps made elsewhere: files -> checked statements. The story begins in `imported_rows.py`."""
