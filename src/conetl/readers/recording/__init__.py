"""Drive folders while they are being recorded. The story begins in `drive.py`; it imports `readers.drives`."""
