"""QA reports: what one drive, or one night, did to the map, on one HTML page for the file and the printer.

It imports `exports` and everything below it. Start with `drive_page.py`.
"""
