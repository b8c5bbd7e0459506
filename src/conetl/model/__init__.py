"""Frozen, validated records, parameters, rejections and errors.

No other package of conetl is imported, no files are read. The story begins in `records.py`.
"""
