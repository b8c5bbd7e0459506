"""A made-up road over days: cones that are set, moved and removed, and drives that observe or miss them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from conetl.mapping.history import DriveEvidence
from conetl.mapping.visibility import NotObserved
from conetl.model.feature_classes import CONE
from conetl.model.map_records import MapFeature
from tests import records
from tests.records import standing_at
from tests.synthetic.world import ORIGIN_M, START_NS, evidence_of

HOUR_NS = 3_600_000_000_000
SECOND_NS = 1_000_000_000
SPEED_M_S, SIGMA_M = 10.0, 0.3
SIDE_M = 8.0
"""Cones nearer to the path than this are visible."""
POOR_SIDE_M = 3.2
"""Farther to the side than this the evidence is weak."""
Floats = np.ndarray


@dataclass
class Cone:
    """Positions of a cone over time: (from_ns, xy or None if removed)."""

    height_m: float
    states: list[tuple[int, tuple[float, float] | None]]

    def at(self, time_ns: int) -> tuple[float, float] | None:
        place = None
        for since_ns, state in self.states:
            if since_ns <= time_ns:
                place = state
        return place


def random_world(rng: np.random.Generator, length_m: float, days: int) -> list[Cone]:
    """Cones along both sides of a straight road, 0.8 m apart and more, each with its own fate."""
    cones = []
    at = 0.0
    while at < length_m:
        at += float(rng.choice([rng.uniform(0.8, 2.0), rng.uniform(5.0, 40.0)]))
        place = (at, float(rng.choice([-3.0, 3.0]) + rng.normal(0, 0.2)))
        since = int(rng.integers(0, days * 24)) * HOUR_NS * int(rng.random() < 0.4)
        states: list[tuple[int, tuple[float, float] | None]] = [(START_NS - HOUR_NS + since, place)]
        if rng.random() < 0.5:
            later = since + int(rng.integers(1, days * 24)) * HOUR_NS
            moved = (place[0] + float(rng.uniform(-2.5, 2.5)), place[1] + float(rng.uniform(-1.0, 1.0)))
            states.append((START_NS + later, moved if rng.random() < 0.5 else None))
        cones.append(Cone(float(rng.choice([0.5, 0.7])), states))
    return cones


def random_drive(
    rng: np.random.Generator,
    world: list[Cone],
    number: int,
    *,
    start_ns: int,
    span_m: tuple[float, float],
) -> DriveEvidence:
    """One drive along a part of the road: a common offset, noise, missed cones, and its visibility."""
    name = f"drive {number} {rng.integers(1 << 60)}"
    offset = rng.normal(0, SIGMA_M, 2)
    west, east = span_m
    path = np.arange(west, east + 1, 2.0)
    tracks = []
    for i, cone in enumerate(world):
        seen_ns = start_ns + int((cone.states[0][1][0] - west) / SPEED_M_S * SECOND_NS)  # type: ignore[index]
        place = cone.at(seen_ns)
        if place is None or not west <= place[0] <= east or rng.random() < 0.15:
            continue
        x, y = np.array(place) + offset + rng.normal(0, 0.03, 2)
        xyz = (float(ORIGIN_M[0] + x), float(ORIGIN_M[1] + y), float(ORIGIN_M[2] + rng.normal(0, 0.02)))
        tracks.append(
            records.track(
                len(tracks),
                category="drum" if i % 4 == 3 else CONE,
                **standing_at(xyz, cone.height_m, (SIGMA_M**2, 0.0, 0.0, SIGMA_M**2, 0.0, 0.1))
                | {"object_height_m": cone.height_m + float(rng.normal(0, 0.01))},
                relative_cov_m2=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3),
                existence_probability=float(rng.uniform(0.7, 0.99)),
                observation_count=int(rng.integers(3, 20)),
                seen_ns=seen_ns,
                last_seen_ns=seen_ns + SECOND_NS,
                members=((i, 0),),
            )
        )
    return evidence_of(
        name,
        start_ns,
        tracks,
        np.column_stack([ORIGIN_M[0] + path, np.full(len(path), ORIGIN_M[1])]),
        influence_m=60.0,
        check_visibility=_visibility(
            np.array([t.xyz_m for t in tracks]).reshape(-1, 3), start_ns, span_m, rng.random()
        ),
    )


def _visibility(
    seen: Floats, start_ns: int, span_m: tuple[float, float], blind_share: float
) -> Callable[[MapFeature, Floats], NotObserved | None]:
    """Every location beside the path was visible, except behind a lorry and where a cone was observed."""
    west, east = span_m
    blind = (west + blind_share * (east - west), west + blind_share * (east - west) + 25.0)

    def check_visibility(feature: MapFeature, offset_m: Floats, _others_m: Floats) -> NotObserved | None:
        location = np.array(feature.xyz_m) + offset_m
        along, aside = location[:2] - ORIGIN_M[:2]
        if not west <= along <= east or abs(aside) > SIDE_M or blind[0] <= along <= blind[1]:
            return None
        if len(seen) and np.hypot(*(seen - location)[:, :2].T).min() <= 0.5:
            return None
        first_ns = start_ns + int((along - west) / SPEED_M_S * SECOND_NS)
        # Far from the path it takes several drives to remove a cone.
        ratio = -3.5 if abs(aside) < POOR_SIDE_M else -1.2
        return NotObserved(10, first_ns, ratio) if first_ns > feature.last_seen_ns else None

    return check_visibility
