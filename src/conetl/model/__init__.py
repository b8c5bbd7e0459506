"""Frozen, validated records, parameters, rejections and errors.

No other package of conetl is imported, no files are read. Start with `base.py`, `rig.py` and `drive.py`;
`feature_classes.py` lists the classes of objects, `params.py` all parameters.
"""
