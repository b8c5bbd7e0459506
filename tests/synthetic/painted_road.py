"""Lane markings on a road over some days, and the drives that observe them: truth for what happens to them on the map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from conetl.mapping.history import DriveEvidence
from conetl.mapping.visibility import NotObserved, markings_in_view, observations_of_drive
from conetl.model.detector_evidence import UNMEASURED, AbsenceFigures
from conetl.model.drive import FramePair
from conetl.model.feature_classes import CONE, LANE_MARKING
from conetl.model.markings import MarkingTrack
from conetl.model.params import ReconcileParams
from tests import records
from tests.synthetic.world import ORIGIN_M, START_NS, evidence_of, make_path, make_rig, shifted

Floats = NDArray[np.float64]
RIG = make_rig()
SEARCHED = AbsenceFigures(evidence=UNMEASURED, score_threshold=0.3, categories=(CONE, LANE_MARKING))
SPACING_M, DAY_NS = 2.5, 86_400_000_000_000
#: Errors of a drive's lines: across them, slowly changing along them, and in height.
SIGMA_M, SIGMA_Z_M, CORRELATION_M = 0.02, 0.03, 15.0


@dataclass(frozen=True)
class Paint:
    """A lane marking of a straight road: metres along the road and beside it (to the left)."""

    aside_m: float
    span_m: tuple[float, float] = (-1e9, 1e9)
    colour: str = "white"
    width_m: float = 0.12
    pattern: str = "solid"

    def shape(self) -> dict[str, object]:
        dashes = {"dash_m": 3.0, "gap_m": 6.0} if self.pattern == "dashed" else {}
        return {"colour": self.colour, "pattern": self.pattern, "width_m": self.width_m} | dashes


def markings_of(
    paints: Sequence[Paint],
    rng: np.random.Generator,
    span_m: tuple[float, float],
    *,
    seen_ns: int = START_NS,
    offset_m: Sequence[float] | Floats = (0.0, 0.0, 0.0),
    offset_sigma_m: float = 0.05,
) -> list[MarkingTrack]:
    """The markings as a drive observes them along a part of the road: with noise, and an offset of the whole drive."""
    tracks = []
    relative = (1e-6, 0.0, 0.0, SIGMA_M**2, 0.0, SIGMA_Z_M**2)
    whole = tuple(a + b for a, b in zip(relative, records.cov_of(offset_sigma_m), strict=True))
    for paint in paints:
        begin = max(paint.span_m[0], span_m[0]) + rng.uniform(0, 1)
        end = min(paint.span_m[1], span_m[1]) - rng.uniform(0, 1)
        if end - begin < SPACING_M:
            continue
        x = np.linspace(begin, end, max(round((end - begin) / SPACING_M), 1) + 1)
        apart = np.exp(-np.abs(x[:, None] - x) / CORRELATION_M)
        y, z = rng.multivariate_normal(np.zeros(len(x)), apart, size=2) * [[SIGMA_M], [SIGMA_Z_M]]
        vertices_m = ORIGIN_M + np.column_stack([x, paint.aside_m + y, z]) + offset_m
        shape = records.marking(vertices_m, cov_m2=whole, **paint.shape())
        tracks.append(
            records.marking_track(
                shape,
                len(tracks),
                relative_cov_m2=(relative,) * len(x),
                seen_ns=seen_ns,
                last_seen_ns=seen_ns + int((span_m[1] - span_m[0]) * 1e8),
                existence_probability=float(rng.uniform(0.8, 0.99)),
                observation_count=int(rng.integers(10, 40)),
            )
        )
    order = rng.permutation(len(tracks))
    return [tracks[k].model_copy(update={"marking_index": n}) for n, k in enumerate(order.tolist())]


def frame_pairs_of(span_m: tuple[float, float], first_ns: int, offset_m: Sequence[float] | Floats) -> list[FramePair]:
    """So that the markings of the part of the road are in view at 4 to 12 m: from before it to before its end."""
    frames = int(span_m[1] - span_m[0]) - 6
    return [shifted(pair, offset_m) for pair in make_path(frames, start_m=span_m[0] - 6.0, first_ns=first_ns)]


def painted_drive(
    paints: Sequence[Paint],
    rng: np.random.Generator,
    number: int,
    *,
    day: float = 0.0,
    span_m: tuple[float, float] = (0.0, 100.0),
    sigma_m: float = 0.05,
    blur_px: float = 0.9,
) -> DriveEvidence:
    """A drive past the markings on some day. blur_px: of its images."""
    params = ReconcileParams()
    name = f"painted {number} {rng.integers(1 << 60)}"
    start_ns = START_NS + int(day * DAY_NS)
    offset_m = rng.normal(0, sigma_m, 3)
    pairs = frame_pairs_of(span_m, start_ns, offset_m)
    view = observations_of_drive(RIG, pairs, (), (), SEARCHED)
    return evidence_of(
        name,
        start_ns,
        (),
        np.array([pair.pose.map_t_body_m[:2] for pair in pairs]),
        markings=markings_of(paints, rng, span_m, seen_ns=start_ns, offset_m=offset_m, offset_sigma_m=sigma_m),
        influence_m=60.0,
        check_visibility=_no_cones,
        check_view=lambda vertices_m: markings_in_view(vertices_m, view, blur_px, params),
    )


def random_painted_drives(rng: np.random.Generator, drives: Sequence[DriveEvidence]) -> list[DriveEvidence]:
    """The drives, which also observe the markings of a road of which something changes every day."""
    days: list[list[Paint]] = [[Paint(aside_m) for aside_m in (4.5, 1.0, -2.5, -6.0)[: rng.integers(2, 5)]]]
    for _ in range(6):
        days.append([changed for paint in days[-1] for changed in _next_day(paint, rng)])
    painted = []
    for number, drive in enumerate(drives):
        east_m = drive.path_m[:, 0] - ORIGIN_M[0]
        span_m = (float(east_m[0]), float(east_m[-1]))
        start_ns = drive.key[0]
        lines = painted_drive(
            days[(start_ns - START_NS) // DAY_NS], rng, number, day=(start_ns - START_NS) / DAY_NS, span_m=span_m
        )
        painted.append(replace(drive, markings=lines.markings, check_view=lines.check_view))
    return painted


def _next_day(paint: Paint, rng: np.random.Generator) -> list[Paint]:
    match int(rng.integers(8)):
        case 0:
            return []
        case 1:
            return [replace(paint, aside_m=paint.aside_m + float(rng.choice([-0.5, 0.5])))]
        case 2:
            return [replace(paint, span_m=(paint.span_m[0], float(rng.uniform(40, 300))))]
        case 3:
            return [paint, Paint(paint.aside_m + 1.7, colour="yellow")]
        case _:
            return [paint]


def _no_cones(*_: object) -> NotObserved | None:
    return None
