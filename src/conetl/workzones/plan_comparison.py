"""Planned against found: work zones of the map compared with plans, where and when drives looked. Pure.

A sighting is a pass of a drive at a zone while it stood. Its devices belong to the nearest plans that are in force then; only if
these do not explain all of them, also to plans whose time is near. What remains outside is longer, elsewhere or without a permit.
The result depends neither on the order of plans and zones nor on that of drives.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC
from typing import Any
from uuid import NAMESPACE_URL, uuid5

import numpy as np
import shapely
from scipy.spatial.distance import pdist

from conetl.geometry.linear_reference import project
from conetl.model.arrays import Bools, Floats
from conetl.model.base import ns_from_utc
from conetl.model.planned_zones import Difference, DifferenceKind, PlannedZone
from conetl.model.rig import Side
from conetl.model.work_zone_params import PlanParams
from conetl.workzones.looks import DriveFrames, FoundZone, Look, Looks, SeenZone, sightings_of

_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/plan_difference")
_SAMPLE_M = 5.0
_OPEN_NS = np.iinfo(np.int64).max
_HOUR_NS, _MINUTE_NS, _DAY_NS = 3_600_000_000_000, 60_000_000_000, 86_400_000_000_000
#: A plan has a zone if it has this share of its devices, or enough of them.
_MOST = 0.5
_SIDES: tuple[Side, ...] = ("left", "right")
_ALL_LANES = re.compile(r"\b(all|both|complete|entire|full)|allLanes|Complete", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class PlacedPlan:
    """A plan in the map's CRS."""

    list_name: str
    plan: PlannedZone
    shape: Any
    """Of shapely: lines, points and areas."""

    @property
    def key(self) -> tuple[str, str]:
        return self.list_name, self.plan.plan_id


@dataclass
class _Match:
    """A zone that stands in the place of a plan."""

    seen: SeenZone
    placed: PlacedPlan
    offs_h: list[float] = field(default_factory=lambda: [0.0])
    """As `_off_h`, of its sightings."""
    outside: list[tuple[bool, float, float]] = field(default_factory=list)
    """Sightings with devices beyond the tolerance of all plans: several devices, how far, and how much longer the zone is (m)."""

    def departure_m(self) -> tuple[float, float]:
        """How far beyond the tolerance it stands, and how much longer it is. A device alone, seen once, may be a stray."""
        surely = [one[1:] for one in self.outside if one[0]] or sorted(one[1:] for one in self.outside)[:-1]
        return max(surely, default=(0.0, 0.0))


@dataclass(frozen=True, eq=False)
class _Times:
    """Intervals of a plan (UTC ns), and which looks were in them."""

    spans: tuple[tuple[int, int], ...]
    looks: tuple[Look, ...]
    coverage: float


def shape_of(parts_m: Sequence[Floats]) -> Any:
    """The parts of a plan (N, 2 each) as one geometry: of one position a point, closed ones areas, else lines."""
    made: list[Any] = []
    for part in parts_m:
        if len(part) < 2 or not np.ptp(part, axis=0).any():
            made.append(shapely.Point(part[0]))
        elif len(part) > 3 and (part[0] == part[-1]).all() and (area := shapely.Polygon(part)).is_valid:
            made.append(area)
        else:
            made.append(shapely.LineString(part))
    return made[0] if len(made) == 1 else shapely.GeometryCollection(made)


def compare(
    plans: Sequence[PlacedPlan],
    zones: Sequence[FoundZone],
    drives: Sequence[DriveFrames],
    params: PlanParams,
    *,
    at_ns: int,
) -> list[Difference]:
    """All rows at an instant, by plan, zone and kind; nothing of plans that have not begun unless a zone stands there."""
    looks = Looks(drives, params)
    valid = sorted((one for one in plans if not one.plan.is_void), key=lambda one: one.key)
    times = {one.key: _times(one, looks, at_ns) for one in valid}
    seen = [sightings_of(zone, looks, params) for zone in sorted(zones, key=lambda zone: str(zone.zone_id))]
    tree = shapely.STRtree([one.shape for one in valid])
    matches: list[_Match] = []
    unplaced: list[tuple[SeenZone, list[PlacedPlan]]] = []
    for one in seen:
        if not one.sightings:  # what was left of another zone, and not passed since
            continue
        place = shapely.MultiPoint(one.xy_m)
        rows = sorted(tree.query(place, "dwithin", distance=max(params.near_m, params.approximate_m)).tolist())
        near = [valid[k] for k in rows if _may_be(one, valid[k], times[valid[k].key], place, params)]
        found = _matches(one, near, times, params)
        matches += found
        if not found:
            unplaced.append((one, near))
    rows_found = list(_elsewhere(unplaced, {match.placed.key for match in matches}, times, params))
    rows_found += [row for match in matches for row in _of_match(match, matches, times[match.placed.key], params)]
    rows_found = _without_merged(rows_found, zones)
    met = {row.key for row in rows_found}
    rows_found += [row for one in valid if one.key not in met for row in _not_met(one, times[one.key], at_ns, params)]
    return sorted(rows_found, key=lambda row: (row.list_name or "", row.plan_id or "", str(row.zone_id), row.kind))


def _without_merged(rows: Sequence[Difference], zones: Sequence[FoundZone]) -> list[Difference]:
    """Rows but those of zones whose devices are of another one since, if that one has the same row, or a difference."""
    into = {zone.zone_id: zone.merged_into for zone in zones if zone.merged_into is not None}
    known = {(one.zone_id, one.key, kind) for one in rows for kind in (one.kind, DifferenceKind.PERMITTED)}
    return [one for one in rows if one.zone_id is None or (into.get(one.zone_id), one.key, one.kind) not in known]


def _times(placed: PlacedPlan, looks: Looks, at_ns: int) -> _Times:
    plan = placed.plan
    start, end = ns_from_utc(plan.starts_at), _OPEN_NS if plan.ends_at is None else ns_from_utc(plan.ends_at)
    parts = [(ns_from_utc(one.starts_at or plan.starts_at), one.ends_at or plan.ends_at) for one in plan.periods]
    cut = [(max(start, a), end if b is None else min(end, ns_from_utc(b))) for a, b in parts]
    spans = tuple(sorted((a, b) for a, b in cut if a < b)) or ((start, end),)
    samples = shapely.get_coordinates(shapely.segmentize(placed.shape, _SAMPLE_M))
    some = tuple(
        one for one in looks.at(samples) if any(a <= one.from_ns and one.until_ns <= min(b, at_ns) for a, b in spans)
    )
    return _Times(spans, some, float(np.any([look.seen for look in some], axis=0).mean()) if some else 0.0)


def _may_be(one: SeenZone, placed: PlacedPlan, times: _Times, place: Any, params: PlanParams) -> bool:
    """Whether a zone may be of a plan, by their distance, and in time: it was not certainly absent all the time."""
    reach_m = max(params.near_m, _tolerance_m(placed, params))
    start, end = times.spans[0][0], times.spans[-1][1]
    days_ns = params.same_works_days * _DAY_NS
    return (
        place.distance(placed.shape) <= reach_m
        and one.zone.first_seen_ns <= end + days_ns
        and one.zone.last_seen_ns >= start - days_ns
        and (one.absent_ns is None or one.absent_ns < end)
        and (one.zone.gone_ns is None or one.zone.gone_ns > start)
    )


def _tolerance_m(placed: PlacedPlan, params: PlanParams) -> float:
    return params.approximate_m if placed.plan.approximate else params.tolerance_m


def _matches(
    one: SeenZone, near: Sequence[PlacedPlan], times: dict[tuple[str, str], _Times], params: PlanParams
) -> list[_Match]:
    """The plans in whose places a zone stands, over all sightings."""
    found: dict[tuple[str, str], _Match] = {}
    for at_ns, xy_m in one.sightings if near else ():
        outside_m = _outside_m(near, xy_m, one.zone.sigma_m, params)
        offs_h = [_off_h(times[placed.key], one, at_ns, params) for placed in near]
        own = _own(outside_m, near, xy_m, np.array(offs_h) == 0.0, params)
        if not own.any() or outside_m[own.any(axis=1)].min(axis=0).max() > 0:
            own = _own(outside_m, near, xy_m, np.ones(len(near), bool), params)
        used = np.flatnonzero(own.any(axis=1))
        for k in used.tolist():
            found.setdefault(near[k].key, _Match(one, near[k])).offs_h.append(offs_h[k])
        beyond_m = np.sort(outside_m[used].min(axis=0))[-2:] if len(used) else np.zeros(1)
        if beyond_m[-1] > 0:
            counts, means = own.sum(axis=1).tolist(), outside_m.mean(axis=1).tolist()
            main = max(used.tolist(), key=lambda k: (counts[k], -means[k], near[k].key))
            allowed_m = sum(_length_m(near[k].shape) for k in used.tolist()) + params.tolerance_m
            longer_m = _extent_m(xy_m, near[main].shape) - allowed_m
            found[near[main].key].outside.append((bool(beyond_m[0] > 0), float(beyond_m[-1]), longer_m))
    return list(found.values())


def _outside_m(near: Sequence[PlacedPlan], xy_m: Floats, sigma_m: float, params: PlanParams) -> Floats:
    """(K, N) how far devices (N, 2) stand outside of the tolerance of each plan; negative inside."""
    points = shapely.points(xy_m)
    distances_m = np.array([shapely.distance(placed.shape, points) for placed in near])
    allowed_m = np.array([_tolerance_m(placed, params) for placed in near]) + params.sigmas * sigma_m
    return np.asarray(distances_m - allowed_m[:, None])


def _own(outside_m: Floats, near: Sequence[PlacedPlan], xy_m: Floats, among: Bools, params: PlanParams) -> Bools:
    """(K, N) which devices belong to which plan `among` those; none of a plan that has only a few at an end of the zone."""
    apart_m = np.where(among[:, None], outside_m, np.inf)
    own = (apart_m <= 0) & (apart_m <= apart_m.min(axis=0) + params.same_lines_m)
    for k, placed in enumerate(near):
        enough_m = min(params.tolerance_m, _length_m(placed.shape) / 2)
        if own[k].mean() < _MOST and (own[k].sum() < 2 or pdist(xy_m[own[k]]).max() < enough_m):
            own[k] = False
    return np.asarray(own)


def _off_h(times: _Times, one: SeenZone, at_ns: int, params: PlanParams) -> float:
    """Hours by which a sighting is before the next time of a plan (negative) or after the last one; 0 in time.

    Between two times it is late, unless the zone was absent at the end of the earlier one.
    """
    slack_ns = params.tolerance_min * _MINUTE_NS
    if any(a - slack_ns <= at_ns <= b + slack_ns for a, b in times.spans):
        return 0.0
    ends = [b for _, b in times.spans if b < at_ns and (one.absent_ns is None or one.absent_ns < b)]
    starts = [a for a, _ in times.spans if a > at_ns]
    return (at_ns - ends[-1]) / _HOUR_NS if ends else (at_ns - starts[0]) / _HOUR_NS if starts else math.inf


def _length_m(shape: Any) -> float:
    """Of lines their length, of areas their largest extent."""
    parts = shapely.get_parts(shape)
    areas = shapely.get_coordinates(parts[shapely.get_dimensions(parts) == 2])
    lines_m = float(shapely.length(parts[shapely.get_dimensions(parts) == 1]).sum())
    return lines_m + (float(pdist(areas).max()) if len(areas) else 0.0)


def _extent_m(xy_m: Floats, shape: Any) -> float:
    """Of devices along the line of a plan, or of them alone."""
    line = shapely.get_coordinates(shape)
    if shape.geom_type == "LineString":
        return float(np.ptp(project(line, xy_m)[0]))
    return float(pdist(xy_m).max()) if len(xy_m) > 1 else 0.0


def _elsewhere(
    unplaced: Sequence[tuple[SeenZone, list[PlacedPlan]]],
    met: set[tuple[str, str]],
    times: dict[tuple[str, str], _Times],
    params: PlanParams,
) -> Iterator[Difference]:
    """Zones in no plan's place: each unmet plan in force nearby has one of them at most, the others have no permit."""
    pairs = []
    for number, (one, near) in enumerate(unplaced):
        for placed in near:
            in_force = any(_off_h(times[placed.key], one, at_ns, params) == 0.0 for at_ns, _ in one.sightings)
            if in_force and placed.key not in met:
                away_m = float(shapely.distance(placed.shape, shapely.points(one.xy_m)).max())
                pairs.append((away_m, placed.key, str(one.zone.zone_id), number, placed))
    given: dict[int, tuple[float, PlacedPlan]] = {}
    for away_m, key, _, number, placed in sorted(pairs, key=lambda pair: pair[:3]):
        if number not in given and key not in met:
            given[number] = away_m, placed
            met = met | {key}
    for number, (one, _) in enumerate(unplaced):
        if number in given:
            away_m, placed = given[number]
            text = f"its farthest device stands {away_m:.0f} m from the permitted place"
            surely = _surely(away_m - _tolerance_m(placed, params), one.zone.sigma_m)
            yield _row(DifferenceKind.ELSEWHERE, text, one, placed, times[placed.key], amount=away_m, unit="m",
                sigma=one.zone.sigma_m, confidence=one.zone.existence * surely)  # fmt: skip
        else:
            text = f"no permit that is in force within {params.near_m:g} m"
            yield _row(DifferenceKind.NO_PERMIT, text, one, None, None, confidence=one.zone.existence)


def _of_match(match: _Match, matches: Sequence[_Match], times: _Times, params: PlanParams) -> Iterator[Difference]:
    one, zone, placed = match.seen, match.seen.zone, match.placed

    def row(kind: DifferenceKind, text: str, **values: Any) -> Difference:
        surely = values.pop("confidence", 1.0)
        return _row(kind, text, one, placed, times, confidence=zone.existence * surely, **values)

    found = []
    outside_m, longer_m = match.departure_m()
    if outside_m > 0:
        surely = _surely(outside_m + params.sigmas * zone.sigma_m, zone.sigma_m)
        of_place = {"unit": "m", "sigma": zone.sigma_m, "confidence": surely}
        if longer_m > 0:
            longer_m += params.tolerance_m
            text = f"{longer_m:.0f} m longer than permitted"
            found.append(row(DifferenceKind.LONGER, text, amount=longer_m, **of_place))
        else:
            away_m = outside_m + _tolerance_m(placed, params) + params.sigmas * zone.sigma_m
            text = f"it reaches {away_m:.0f} m beyond the permitted place"
            found.append(row(DifferenceKind.ELSEWHERE, text, amount=away_m, **of_place))
    if (early_h := -min(match.offs_h)) > 0:
        found.append(row(DifferenceKind.EARLY, f"seen {early_h:.1f} h before it may stand", amount=early_h, unit="h"))
    if (late_h := max(match.offs_h)) > 0:
        found.append(row(DifferenceKind.OVERRUN, f"seen {late_h:.1f} h after the end", amount=late_h, unit="h"))
    if lanes := _other_lanes(zone, placed.plan):
        found.append(row(DifferenceKind.OTHER_LANES, lanes, unit="lanes"))
    end = next((b for a, b in reversed(times.spans) if a <= zone.last_seen_ns and b < _OPEN_NS), None)
    if zone.gone_ns is not None and end is not None and zone.gone_ns < end - params.tolerance_min * _MINUTE_NS:
        others = [m.seen.zone for m in matches if m.placed is placed and m.seen is not one]
        if all(other.last_seen_ns <= zone.gone_ns for other in others):
            left_h = (end - zone.gone_ns) / _HOUR_NS
            found.append(
                row(DifferenceKind.ENDED_EARLY, f"gone {left_h:.1f} h before the end", amount=left_h, unit="h")
            )
    yield from found or [row(DifferenceKind.PERMITTED, "in its place, time and lanes")]


def _other_lanes(zone: FoundZone, plan: PlannedZone) -> str:
    """What is closed and not permitted, as far as both are known; empty: nothing."""
    words = [word for word in plan.lanes if word]
    every = any(_ALL_LANES.search(word) for word in words)
    sides = {side for side in _SIDES if every or any(side in word.lower() for word in words)}
    if sides and zone.closed_side is not None and zone.closed_side not in sides:
        return f"closed on the {zone.closed_side}, permitted: {', '.join(words)}"
    if plan.closed_lane_count is not None and (zone.closed_lane_count or 0) > plan.closed_lane_count and not every:
        return f"{zone.closed_lane_count} lanes closed, permitted: {plan.closed_lane_count}"
    return ""


def _not_met(placed: PlacedPlan, times: _Times, at_ns: int, params: PlanParams) -> Iterator[Difference]:
    """A plan without a zone, if it has begun."""
    if times.spans[0][0] > at_ns:
        return
    share = f"{_passed(times.coverage)} in its time"
    if times.coverage >= params.least_coverage and not placed.plan.approximate:
        text, kind, confidence = f"nothing stands there: {share}", DifferenceKind.NOT_FOUND, times.coverage
    else:
        text, kind, confidence = share, DifferenceKind.NOT_LOOKED, 1.0
        joint = "but" if times.coverage else "and"
        text += f", {joint} its place is only known roughly" if placed.plan.approximate else ""
    yield _row(kind, text, None, placed, times, confidence=confidence)


def _passed(coverage: float) -> str:
    if coverage == 0:
        return "no drive passed it"
    part = "all" if coverage == 1 else f"{min(max(round(100 * coverage), 1), 99)}%"
    return f"drives passed {part} of it"


def _surely(excess_m: float, sigma_m: float) -> float:
    """Probability that a difference is more than a limit that it exceeds by excess_m."""
    return 0.5 * (1.0 + math.erf(excess_m / sigma_m / math.sqrt(2.0))) if sigma_m > 0 else 1.0


def _row(
    kind: DifferenceKind,
    text: str,
    one: SeenZone | None,
    placed: PlacedPlan | None,
    times: _Times | None,
    **values: Any,
) -> Difference:
    shape: Any = shapely.MultiPoint(one.zone.phases[-1].xy_m) if one is not None else getattr(placed, "shape", None)
    if placed is not None and times is not None:
        values |= {"list_name": placed.list_name, "plan_id": placed.plan.plan_id, "coverage": times.coverage}
        start, end = placed.plan.starts_at, placed.plan.ends_at
        values |= {"planned_from": start.astimezone(UTC), "planned_until": end and end.astimezone(UTC)}
    if one is not None:
        values |= {"zone_id": one.zone.zone_id} | {
            name: getattr(one, name) for name in ("absent", "first", "last", "gone")
        }
    elif times is not None and times.looks:
        values |= {"first": times.looks[0].sight, "last": times.looks[-1].sight}
    centre = shapely.minimum_bounding_circle(shape).centroid
    centre = shape.centroid if centre.is_empty else centre
    made = "/".join(str(values.get(name)) for name in ("list_name", "plan_id", "zone_id"))
    return Difference(
        difference_id=uuid5(_NAMESPACE, f"{kind}/{made}"), kind=kind, text=text, xy_m=(centre.x, centre.y),
        radius_m=float(shapely.minimum_bounding_radius(shape)), **values,
    )  # fmt: skip
