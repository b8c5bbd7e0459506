"""Rendered drives with known truth (requires the extra `conetl[simulate]`; only this package imports Mitsuba)."""
