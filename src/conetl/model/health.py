"""Health checks: tests of a whole recording that decide what the map may believe."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from enum import StrEnum
from shlex import quote
from typing import Any, Literal
from uuid import UUID

from conetl.model.base import NonNegative, Record

#: Of a drive against the map, where the map does not contradict it.
AGREEMENT = "agreement with the map"
#: Of a drive against those that the same cameras recorded right before and after it.
ADJOINING = "position against adjoining drives"
#: Of the calibration against the images; its detail is the outcome of the self-calibration.
CALIBRATION = "calibration"


class Verdict(StrEnum):
    """What follows from a health check."""

    PASS = "pass"
    CORRECTED = "corrected"
    """The recording is wrong, and the analysis has corrected it."""
    WARN = "warn"
    """A person should check it; the drive counts."""
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

    @property
    def figures(self) -> str:
        """What was measured, with its sigma, unit and limit; empty where the recording does not show it."""
        if self.value is None:
            return ""
        sigma = "" if self.sigma is None else f" +- {self.sigma:.2g}"
        limit = "" if self.limit is None else f" (limit {self.limit:.3g})"
        return f"{self.value:.3g}{sigma}{self.unit and f' {self.unit}'}{limit}"


def hold(name: str, detail: str, *, value: float | None, **figures: Any) -> HealthCheck:
    """A check that puts the drive on hold; figures: other fields."""
    return HealthCheck(name=name, verdict=Verdict.HOLD, detail=detail, value=value, **figures)


def hold_if(wrong: object, name: str, detail: str, *, value: float | None, **figures: Any) -> HealthCheck:
    """A check that puts the drive on hold if something is wrong, and passes otherwise; figures: other fields."""
    check = hold(name, detail, value=value, **figures)
    return check if wrong else check.model_copy(update={"verdict": Verdict.PASS})


AGREES = HealthCheck(
    name=AGREEMENT,
    verdict=Verdict.PASS,
    value=None,
    detail="The map as earlier drives left it does not contradict the drive.",
)


class HeldDrive(Record):
    """A drive on hold."""

    drive_id: str
    changeset_no: int
    changeset_id: UUID
    since: datetime
    checks: tuple[HealthCheck, ...]
    """Those that it did not pass."""

    @property
    def reason(self) -> str:
        return hold_reason(self.checks) or ""


class HoldChange(Record):
    """What an ingest or a decision did to another drive: it went on hold, or is on hold no longer."""

    drive_id: str
    changeset_no: int
    changeset_id: UUID
    state: Literal["on hold", "released", "reverted", "replaced"]
    reason: str
    """Why it is, or was, on hold."""

    @property
    def sentence(self) -> str:
        drive = f"drive {self.drive_id} (changeset {self.changeset_no})"
        match self.state:
            case "on hold":
                return f"On hold now: {drive}. {self.reason} See `conetl drive held`."
            case "released":
                return f"Released: {drive} counts from now on."
            case "reverted":
                return f"No longer on hold: {drive} was reverted."
            case "replaced":
                return f"No longer on hold: {drive} was replaced by a later delivery of the recording."


class HoldEvent(Record):
    """One step in the history of a drive that is or was on hold."""

    at: datetime
    drive_id: str
    changeset_no: int
    changeset_id: UUID
    what: str
    """on hold, released, accepted, acceptance withdrawn, reverted, revert withdrawn or delivered again."""
    detail: str
    """The note of a decision, or what ended the hold."""
    by: str | None
    """Who decided; None of what the checks decided, and if no name was given."""
    checks: tuple[HealthCheck, ...]
    """Those for which it went on hold; empty of other events."""

    @property
    def sentence(self) -> str:
        by = f" by {self.by}" if self.by else ""
        detail = self.detail or ", ".join(f"{check.name} {check.figures}".strip() for check in self.checks)
        return f"{self.what}{by}{detail and f': {detail}'}"


def what_to_do(drive: str | int) -> str:
    """How to get a drive (its id, or changeset number) off hold."""
    accept = f"conetl drive accept {quote(str(drive))} --note REASON"
    return f"Deliver the drive again with that corrected, or accept it as it is: {accept}"


def holding(checks: Sequence[HealthCheck]) -> tuple[HealthCheck, ...]:
    """The checks for which a drive is held."""
    return tuple(check for check in checks if check.verdict is Verdict.HOLD)


def hold_reason(checks: Sequence[HealthCheck]) -> str | None:
    """The causes for which a drive is held, as sentences; None where it counts."""
    return " ".join(check.detail for check in holding(checks)) or None
