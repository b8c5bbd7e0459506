"""The commands `conetl map ...` and `conetl base ...`. Start with `show.py`."""
