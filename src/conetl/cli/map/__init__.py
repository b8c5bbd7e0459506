"""`conetl map ...` and `conetl base`: look at maps, decide about them, take them elsewhere.

Like all of `cli`, it may import everything. The story begins in `show.py`.
"""
