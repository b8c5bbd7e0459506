"""Made-up lane closures: a road with lane lines, a drive that passes, cones in taper and tangent, and a known fault."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal
from uuid import UUID

import numpy as np

from conetl.geometry.linear_reference import locate, stations
from conetl.model.map_records import MapFeature
from conetl.model.work_zone_records import DrivePath, LaneLine, ZoneHistory
from conetl.workzones.layout_check import allowed_spacing_m, layout_rules, taper_ratio
from tests import records

Fault = Literal["none", "missing", "spacing", "in lane", "short taper"]
Floats = np.ndarray
ORIGIN_M = np.array([458_300.0, 5_427_800.0])
LANE_M = 3.5


@dataclass(frozen=True)
class Closure:
    """A zone with its road, and what is wrong with it."""

    zone: ZoneHistory
    paths: list[DrivePath]
    lanes: list[LaneLine]
    speed_kmh: float
    fault: Fault
    gap: tuple[UUID, UUID] | None
    """Cones on both sides of the missing cone or the wide gap."""
    stray: UUID | None


def cone(number: int, xy_m: Floats, sigma_m: float) -> MapFeature:
    here = records.standing_at((*xy_m, 115.0), cov_m2=records.cov_of(max(sigma_m, 0.005)))
    return records.feature(number + 1, seen_ns=1, last_seen_ns=2, **here)


def zone_of(cones: list[MapFeature]) -> ZoneHistory:
    return ZoneHistory(UUID(int=10**6), 1, None, None, tuple(cones))


def road(rng: np.random.Generator, length_m: float) -> Floats:
    """Centre of the closed lane, in the direction of travel: a gentle curve that begins 60 m before station 0."""
    curvature = rng.uniform(-1, 1) / 600.0
    way = np.arange(-60.0, length_m + 60.0, 2.0)
    heading = rng.uniform(0, 2 * np.pi) + curvature * way
    steps = np.stack([np.cos(heading), np.sin(heading)], axis=1) * 2.0
    return ORIGIN_M + np.cumsum(steps, axis=0)


def closure(seed: int, fault: Fault, *, sigma_m: float = 0.1, with_lanes: bool = True) -> Closure:
    """The right-hand (odd seeds: left-hand) lane closed by taper and tangent, spaced at 70 to 93 % of what the rule allows."""
    rng = np.random.default_rng(seed)
    speed_kmh = float(
        rng.choice([50.0, 60.0, 80.0, 100.0] if fault == "short taper" else [30.0, 50.0, 60.0, 80.0, 100.0])
    )
    rules = layout_rules()
    taper_m, tangent_m = (limit * rng.uniform(0.7, 0.93) for limit in allowed_spacing_m(speed_kmh, rules))
    length_m = taper_ratio(speed_kmh, rules) * LANE_M * (0.2 if fault == "short taper" else rng.uniform(1.05, 1.3))
    gaps_in_taper = max(int(np.ceil(length_m / taper_m)), 5)
    if fault == "short taper":
        taper_m = length_m / gaps_in_taper
    gaps_in_tangent = int(rng.integers(6, 11))
    gaps = np.array([taper_m] * gaps_in_taper + [tangent_m] * gaps_in_tangent)
    gaps *= rng.uniform(0.97, 1.03, len(gaps))
    knot_m = float(gaps[:gaps_in_taper].sum())
    wide = None
    if fault == "spacing":
        wide = int(rng.integers(1, len(gaps) - 1))
        gaps[wide] = 1.45 * allowed_spacing_m(speed_kmh, rules)[0 if wide < gaps_in_taper else 1]
        if wide < gaps_in_taper:
            knot_m = float(gaps[:gaps_in_taper].sum())
    s = np.concatenate([[0.0], np.cumsum(gaps)])
    # Across: from the outer edge of the closed lane to its inner one, seen as if the closed lane were on the right.
    o = np.where(s < knot_m, -LANE_M / 2 + LANE_M * s / knot_m, LANE_M / 2) + rng.normal(0, 0.03, len(s))
    numbers = list(range(len(s)))
    gap = stray = None
    if fault == "missing":
        lost = int(rng.integers(1, len(s) - 1))
        gap = (UUID(int=lost), UUID(int=lost + 2))
        s, o, numbers = np.delete(s, lost), np.delete(o, lost), [k for k in numbers if k != lost]
    if wide is not None:
        gap = (UUID(int=wide + 1), UUID(int=wide + 2))
    if fault == "in lane":
        at = float(rng.uniform(s[2], s[-2]))
        row_m = float(np.interp(at, s, o))
        stray = UUID(int=501)
        s, o, numbers = np.append(s, at), np.append(o, row_m + rng.uniform(1.2, 2.2)), [*numbers, 500]
    sign = -1.0 if seed % 2 else 1.0
    centre = road(rng, float(s.max()))
    truth = locate(centre, s + 60.0, sign * o)
    seen = truth + rng.normal(0, sigma_m, truth.shape)
    cones = [cone(number, xy, sigma_m) for number, xy in zip(numbers, seen, strict=True)]
    way = stations(centre)
    wander = 0.2 * np.sin(way / 25.0)
    path = locate(centre, way, sign * LANE_M + wander)
    lanes = [LaneLine(locate(centre, way, np.full(len(way), sign * k * LANE_M))) for k in (-0.5, 0.5, 1.5)]
    return Closure(
        zone=zone_of([cones[k] for k in rng.permutation(len(cones))]),
        paths=[DrivePath("drive", 1, path)],
        lanes=lanes if with_lanes else [],
        speed_kmh=speed_kmh,
        fault=fault,
        gap=gap,
        stray=stray,
    )
