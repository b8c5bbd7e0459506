"""Rendered drives with known truth (needs the extra `conetl[simulate]`; only this package imports Mitsuba)."""
