"""The commands `conetl map ...` and `conetl base ...`. The story begins in `show.py`."""
