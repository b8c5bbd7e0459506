"""Health checks: tests of a whole recording that decide what the map may believe."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from conetl.model.records import NonNegative, Record


class Verdict(StrEnum):
    """What follows from a health check."""

    PASS = "pass"
    CORRECTED = "corrected"
    """The recording is wrong, and the analysis has corrected it."""
    WARN = "warn"
    """A person should look; the drive counts."""
    HOLD = "hold"
    """The drive is stored, but does not count until a person accepts it."""


class HealthCheck(Record):
    """One test of a recording."""

    name: str
    verdict: Verdict
    value: float | None
    """What was measured; None where the recording does not show it."""
    sigma: NonNegative | None = None
    limit: float | None = None
    """The largest value (or smallest, as `detail` says) that passes."""
    unit: str = ""
    detail: str
    """One sentence: what was found, and what to do unless the check passes."""


def hold_reason(checks: Sequence[HealthCheck]) -> str | None:
    """The causes for which a drive is held, as sentences; None where it counts."""
    return " ".join(check.detail for check in checks if check.verdict is Verdict.HOLD) or None
