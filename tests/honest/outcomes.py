"""What became of honest recordings, one by one and by shape of error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.consistency import Consistency, Nees, pooled
from conetl.model.health import HealthCheck, Verdict, hold_reason

Floats = NDArray[np.float64]
PARTS = ("absolute", "relative", "common")


@dataclass(frozen=True)
class Outcome:
    """Of one recording."""

    shape: str
    on: str
    """What the log was put on."""
    sigma_m: float
    """The stated one, of eastings and northings."""
    seed: int
    held: str | None = None
    verdicts: dict[str, str] = field(default_factory=dict)
    """Of the checks that do not pass, by name."""
    nees: Consistency | None = None
    """Of its cones; None without any, and without truth."""
    squares_m2: tuple[float, float] = (0.0, 0.0)
    """Sums of the squared errors of its cones, and of their stated variances."""

    @property
    def name(self) -> str:
        return f"{self.shape}, {self.sigma_m:g} m, seed {self.seed}, on {self.on}"

    def with_checks(self, checks: Sequence[HealthCheck]) -> Outcome:
        found = {check.name: check.verdict.value for check in checks if check.verdict is not Verdict.PASS}
        return Outcome(
            self.shape, self.on, self.sigma_m, self.seed, hold_reason(checks), found, self.nees, self.squares_m2
        )

    def with_cones(self, off_m: Floats, variance_m2: Floats, nees: Consistency | None) -> Outcome:
        """off_m, variance_m2: (N, 3) errors of cones and their stated variances."""
        squares = float(np.sum(off_m**2)), float(np.sum(variance_m2))
        return Outcome(self.shape, self.on, self.sigma_m, self.seed, self.held, self.verdicts, nees, squares)

    def as_dict(self) -> dict[str, object]:
        """As JSON values."""
        parts = {} if self.nees is None else {part: vars(getattr(self.nees, part)) for part in PARTS}
        return vars(self) | {"nees": parts}


def figures_of(name: str, outcomes: Sequence[Outcome]) -> dict[str, object]:
    """A row of a table; NEES are per degree of freedom. Outside of its band of 95 % one is marked by +, of 99 % by ++; - and --
    if it is too small."""
    nees = pooled(outcome.nees for outcome in outcomes)
    errors, variances = np.sum([outcome.squares_m2 for outcome in outcomes], axis=0)
    others = Counter(
        verdict for outcome in outcomes for verdict in outcome.verdicts.values() if verdict != Verdict.HOLD
    )
    row: dict[str, object] = {
        "": name, "recordings": len(outcomes), "held": sum(outcome.held is not None for outcome in outcomes),
        "other verdicts": " ".join(f"{n} {verdict}" for verdict, n in sorted(others.items())),
    }  # fmt: skip
    for part in PARTS:
        row[part] = None if nees is None else marked(getattr(nees, part))
    band = (
        None if nees is None else " to ".join(f"{value / nees.absolute.dof:.2f}" for value in nees.absolute.band(0.99))
    )
    return row | {
        "99 % band of absolute": band,
        "rms / sigma": float(np.sqrt(errors / variances)) if variances else None,
    }


def marked(nees: Nees) -> str | None:
    """NEES per degree of freedom, with its mark."""
    if not nees.dof:
        return None
    low, high = nees.band()
    sign = "+" if nees.value > high else "-" if nees.value < low else ""
    return f"{nees.per_dof:.2f} {sign * (1 if nees.holds(0.99) else 2)}".rstrip()


def by(name_of: Callable[[Outcome], str], outcomes: Iterable[Outcome]) -> list[dict[str, object]]:
    """A row per shape or recording, in order, and one of all."""
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(name_of(outcome), []).append(outcome)
    rows = [figures_of(name, group) for name, group in groups.items()]
    return [*rows, figures_of("all", [outcome for group in groups.values() for outcome in group])]
