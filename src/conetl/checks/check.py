"""A row of the table of checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from conetl.model.health import Verdict

#: A unit: of values from 0 to 1.
SHARE = "share"


@dataclass(frozen=True)
class Check:
    """What a health check measures, and what follows. Texts name fields of findings and their facts in braces, `limit` those of
    `CheckParams` and `ReconcileParams.agreement`."""

    name: str
    measured: str
    """What is measured, and from which data."""
    observable: str
    """What the data need for it."""
    effect: str
    """Effect on positions if it is beyond the limit."""
    messages: Mapping[str, str]
    """By the names in `Finding.says`; "" is the one that most findings have."""
    passed: str
    """Message if nothing was found."""
    remedy: str = ""
    """What to do, after all messages; empty if they state it."""
    unobserved: str = "The drive does not show enough for this check."
    """Message if nothing was measured."""
    least: str = ""
    """Name of the limit in `CheckParams`; empty if findings have one, or state themselves whether they are beyond it."""
    sigmas: str = ""
    """Name of the number of sigmas by which a value must also differ."""
    limit: str = ""
    """What else is beyond the limit, in words."""
    treated: str = ""
    """What is corrected, covered or rejected below the limit, in words."""
    unit: str = ""
    """Of values and limits; those of a share are shown in %."""
    expected: float = 0.0
    """The value of a perfect recording."""
    is_smallest: bool = False
    """Values below the limit are beyond it, not those above."""
    follows: Verdict = Verdict.HOLD
    """What follows beyond the limit, unless it is corrected or covered."""
    follows_from: Mapping[str, Verdict] = field(default_factory=dict)
    """What follows from some of the messages instead."""
