"""Rendered drives with ground truth (requires the extra `conetl[simulate]`; only this package imports Mitsuba).

It imports `readers` and everything below it. Start with `simulate.py`.
"""
