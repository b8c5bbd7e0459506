"""Maps made elsewhere: files -> checked statements. Start with `imported_rows.py`."""
