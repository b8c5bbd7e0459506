"""Honest recordings: the errors of their logs stay within what they state, whatever their spectrum; none may be held.

`logs.py` makes logs with errors of many shapes, `drives.py` puts them on simulated motions.
"""
