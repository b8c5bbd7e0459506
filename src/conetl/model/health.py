"""Health checks: tests of a whole recording. They decide whether the drive may change the map.

Where the data are, a check computes a `Finding`;
`checks/verdict.py` makes a `HealthCheck` of it, by the table of `checks/table.py`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from math import floor, log10
from shlex import quote
from typing import Literal
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
    WIDENED = "widened"
    """The recording contradicts its stated sigmas; they were enlarged until they cover it."""
    NOTE = "note"
    """A person should check it; the drive counts."""
    HOLD = "hold"
    """The drive is stored, but does not count until a person accepts it."""

    @classmethod
    def _missing_(cls, value: object) -> Verdict | None:
        return cls.NOTE if value == "warn" else None  # as releases before 0.3 stored it


class Finding(Record):
    """What a check measured. It gives no verdict: `checks.verdict.judge` does."""

    check: str
    """Its name in the table of checks."""
    value: float | None = None
    """What was measured, in the unit of the table; None where it is no number, or the drive does not show it."""
    sigma: NonNegative | None = None
    limit: float | None = None
    """Only where the data give it (a share of the baseline, stated sigmas); else the parameters do."""
    found: bool | None = None
    """Whether a search or test that one number does not express found the fault; None: value and limit are compared."""
    treated: Literal["", "corrected", "widened"] = ""
    """What the analysis did about it."""
    effect_m: NonNegative | None = None
    """By how much positions are wrong because of it, at most; None where the data do not give it in metres."""
    says: tuple[str, ...] = ("",)
    """Names of the messages of the table that apply, in their order."""
    facts: Mapping[str, bool | int | float | str] = {}
    """What these messages name, beside the fields above."""

    def saying(self, *names: str, **facts: bool | int | float | str) -> Finding:
        """The finding with other messages and more facts."""
        return self.model_copy(update={"says": names, "facts": {**self.facts, **facts}})


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
    """What was found, and what to do unless the check passes."""

    @property
    def figures(self) -> str:
        """The measured value with its sigma (both to two digits of the sigma), unit and limit; empty if nothing was measured."""
        if self.value is None:
            return ""
        digits = ".3g" if abs(self.value) < 1000 else ".0f"
        if self.sigma:
            digits = f"z.{max(1 - floor(log10(self.sigma)), 0)}f"
        sigma = f" +- {self.sigma:{digits}}" if self.sigma else ""
        limit = "" if self.limit is None else f" (limit {self.limit:.3g})"
        return f"{self.value:{digits}}{sigma}{self.unit and f' {self.unit}'}{limit}"


class HeldDrive(Record):
    """A drive on hold."""

    drive_id: str
    changeset_no: int
    changeset_id: UUID
    since: datetime
    checks: tuple[HealthCheck, ...]
    """The checks that it failed."""

    @property
    def reason(self) -> str:
        return hold_reason(self.checks) or ""


class HoldChange(Record):
    """An ingest or a decision put another drive on hold, or released it."""

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
                return f"Released: {drive} is now in effect."
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
    """Who decided; None if a check decided, or no name was given."""
    checks: tuple[HealthCheck, ...]
    """The checks that put it on hold; empty for other events."""

    @property
    def sentence(self) -> str:
        by = f" by {self.by}" if self.by else ""
        detail = self.detail or ", ".join(f"{check.name} {check.figures}".strip() for check in self.checks)
        return f"{self.what}{by}{detail and f': {detail}'}"


def hold_remedy(drive: str | int, map_name: str) -> str:
    """How to release a drive (its id, or changeset number) that is on hold."""
    accept = f"conetl drive accept {quote(str(drive))} --map {map_name} --note REASON"
    return f"Correct this and ingest the drive again, or accept it unchanged: {accept}"


def hold_checks(checks: Sequence[HealthCheck]) -> tuple[HealthCheck, ...]:
    """The checks that put a drive on hold."""
    return tuple(check for check in checks if check.verdict is Verdict.HOLD)


def hold_reason(checks: Sequence[HealthCheck]) -> str | None:
    """Why a drive is on hold, in sentences; None if it is not. What several checks advise is said once."""
    text = " ".join(check.detail for check in hold_checks(checks))
    return " ".join(dict.fromkeys(re.split(r"(?<=[.?]) (?=[A-Z])", text))) or None
