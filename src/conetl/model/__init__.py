"""The nouns of conetl as frozen, validated records, with parameters, rejections and errors.

It imports nothing of conetl, reads no files and computes nothing but what a record says of itself. The story begins in
`records.py`.
"""
