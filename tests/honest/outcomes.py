"""What became of honest recordings, one by one and by shape of error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.consistency import Consistency, Nees
from conetl.model.health import HealthCheck, Verdict, hold_reason

Floats = NDArray[np.float64]
#: `centre`: of the mean of all cones of a drive, which errors of the images hardly change. The others are those of `Consistency`;
#: in recordings of the same images the relative errors are about the same, whatever the log, and bands are too narrow.
PARTS = ("centre", "absolute", "relative", "common")


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
    nees: dict[str, Nees] = field(default_factory=dict)
    """Of its cones, by part; empty without any, and without truth."""
    squares: tuple[float, int] = (0.0, 0)
    """Sum of the squared errors of all coordinates, in their stated sigmas, and how many."""

    @property
    def name(self) -> str:
        return f"{self.shape}, {self.sigma_m:g} m, seed {self.seed}, on {self.on}"

    def with_checks(self, checks: Sequence[HealthCheck]) -> Outcome:
        found = {check.name: check.verdict.value for check in checks if check.verdict is not Verdict.PASS}
        return replace(self, held=hold_reason(checks), verdicts=found)

    def with_cones(self, off_m: Floats, cov_m2: Floats, found: Consistency) -> Outcome:
        """off_m (N, 3): errors of cones; cov_m2 (3N, 3N): as stated, of all together; found: the NEES of that."""
        mean_m = off_m.mean(axis=0)
        cov = cov_m2.reshape(len(off_m), 3, len(off_m), 3).mean(axis=(0, 2))
        nees = {"centre": Nees(float(mean_m @ np.linalg.solve(cov, mean_m)), 3)}
        nees |= {part: getattr(found, part) for part in PARTS[1:]}
        squares = float(np.sum(off_m.ravel() ** 2 / np.diagonal(cov_m2)))
        return replace(self, nees=nees, squares=(squares, off_m.size))


def as_json(outcomes: Iterable[Outcome]) -> list[dict[str, object]]:
    return [asdict(outcome) for outcome in outcomes]


def pooled(part: str, outcomes: Iterable[Outcome]) -> Nees:
    """Sum over drives."""
    return reduce(add, (outcome.nees[part] for outcome in outcomes if part in outcome.nees), Nees(0.0, 0))


def figures_of(name: str, outcomes: Sequence[Outcome]) -> dict[str, object]:
    """A row of a table; NEES are per degree of freedom."""
    squares, count = (sum(column) for column in zip(*(outcome.squares for outcome in outcomes), strict=True))
    others = Counter(verdict for one in outcomes for verdict in one.verdicts.values() if verdict != Verdict.HOLD)
    row: dict[str, object] = {
        "": name, "number": len(outcomes), "held": sum(outcome.held is not None for outcome in outcomes),
        "other": " ".join(f"{n} {verdict}" for verdict, n in sorted(others.items())),
    }  # fmt: skip
    for part in PARTS:
        nees = pooled(part, outcomes)
        row[part] = marked(nees)
        if part in PARTS[:2]:
            band = [f"{value / nees.dof:.2f}" for value in nees.band(0.99)] if nees.dof else []
            row[f"{part[:3]} 99 %"] = "-".join(band)
    return row | {"rms/sigma": (squares / count) ** 0.5 if count else None}


def marked(nees: Nees) -> str | None:
    """NEES per degree of freedom; + if it is above its band of 95 %, ++ of 99 %; - or -- if it is below."""
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
