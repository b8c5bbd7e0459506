"""Health checks: from findings, which are computed where the data are, to verdicts, by one table and one rule.

`table.py` lists all checks, `verdict.py` has the rule.
"""
