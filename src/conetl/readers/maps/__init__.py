"""Maps that were made elsewhere: files in, checked statements out. A file is used whole or not at all.

It imports what `readers` may import. The story begins in `statements.py`.
"""
