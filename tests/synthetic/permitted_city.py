"""A city of work zones over nights, with permits that differ in known ways, and what drives could find out about each.

Streets, drives, devices and permits are simulated; zones are made of the devices as on a map, and compared by the real code. What is
expected of each permit follows from the simulated passes alone.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple
from uuid import UUID, uuid5

import numpy as np

from conetl.geometry.linear_reference import locate
from conetl.model.base import utc_from_ns
from conetl.model.map_records import FeatureVersion
from conetl.model.planned_zones import Difference, DifferenceKind, PlannedZone
from conetl.model.work_zone_params import PlanParams, WorkZoneParams
from conetl.model.work_zone_records import DrivePath
from conetl.pipeline.maps.planned_zones import found_zone
from conetl.workzones.looks import DriveFrames, FoundZone
from conetl.workzones.plan_comparison import PlacedPlan, compare, shape_of
from conetl.workzones.work_zones import zones_over_time
from conetl.workzones.zone_layout import describe, layout_of
from tests.synthetic.tapers import ORIGIN_M, cone

HOUR_NS = 3_600_000_000_000
NIGHT_NS = 24 * HOUR_NS
#: Of the first night, 22:00 UTC.
START_NS = 1_772_402_400_000_000_000
SLACK_NS = HOUR_NS // 2
K = DifferenceKind
CASES = (
    "as permitted", "no permit", "ended early", "overrun", "early", "shifted along", "shifted across", "wrong lane", "longer",
    "not set up", "no drive", "half covered", "touching", "touching, one not set up", "beside another's permit",
)  # fmt: skip
ZONES, PLANS = WorkZoneParams(), PlanParams()
_NAMES = UUID(int=67)


class Pass(NamedTuple):
    """A drive along a street, between two stations."""

    at_ns: int
    from_m: float
    to_m: float


@dataclass(frozen=True)
class Stood:
    """A zone as it really stood: from and until (ns), stations, offset to the left of the driven path."""

    begin_ns: int
    end_ns: int
    from_m: float
    to_m: float
    offset_m: float = -2.5

    def passed(self, one: Pass) -> float:
        """Share that a pass went by."""
        return max(0.0, min(self.to_m, one.to_m) - max(self.from_m, one.from_m)) / (self.to_m - self.from_m)


@dataclass(frozen=True)
class Permit:
    begin_ns: int
    end_ns: int
    from_m: float
    to_m: float
    offset_m: float
    nightly: bool = False
    zone: int | None = 0
    """Number of the zone that it permits."""


@dataclass
class Site:
    """A street."""

    number: int
    case: str
    line_m: np.ndarray
    zones: list[Stood]
    permits: list[Permit]
    passes: list[Pass]
    expected: Counter[tuple[str, K]] = field(default_factory=Counter)


def make_site(number: int, case: str, nights: int, rng: np.random.Generator) -> Site:
    heading = rng.uniform(0, 2 * np.pi)
    middle = ORIGIN_M + 2_000.0 * np.array([number % 20, number // 20])
    step = np.array([np.cos(heading), np.sin(heading)])
    line_m = middle + np.array([[-400.0], [400.0]]) * step
    length_m, first, last = (
        rng.uniform(60, 200),
        int(rng.integers(3, nights // 3)),
        int(rng.integers(nights // 2, nights - 4)),
    )
    a, b = 400.0 - length_m / 2, 400.0 + length_m / 2
    begin_ns, end_ns = START_NS + first * NIGHT_NS - 3 * HOUR_NS, START_NS + last * NIGHT_NS + 10 * HOUR_NS
    drawn_m, ends_m = rng.uniform(-4, 4), rng.uniform(-3, 3, 2)
    permit = Permit(begin_ns, end_ns, a + ends_m[0], b + ends_m[1], drawn_m, nightly=bool(rng.random() < 0.15))
    stood = Stood(begin_ns + round(rng.uniform(0, 2) * HOUR_NS), end_ns - round(rng.uniform(0, 0.4) * HOUR_NS), a, b)
    part = (a + b) / 2 if rng.random() < 0.5 else a
    zones, permits, covered = [stood], [permit], (0.0, 800.0)
    shift_m = float(rng.choice([-30.0, 30.0]))
    match case:
        case "as permitted":  # often a part of the permitted place
            zones = [replace(stood, from_m=part)]
        case "no permit":
            permits = []
        case "ended early":
            zones = [replace(stood, end_ns=begin_ns + int(rng.integers(2, 5)) * NIGHT_NS)]
            permits = [replace(permit, nightly=False)]
        case "overrun":
            zones = [replace(stood, end_ns=end_ns + int(rng.integers(2, 6)) * NIGHT_NS)]
        case "early":
            zones = [replace(stood, begin_ns=begin_ns - int(rng.integers(1, 4)) * NIGHT_NS)]
        case "shifted along":
            zones = [replace(stood, from_m=a + shift_m, to_m=b + shift_m)]
        case "shifted across":
            permits = [replace(permit, offset_m=stood.offset_m + shift_m)]
        case "wrong lane":
            zones = [replace(stood, offset_m=2.5)]
        case "longer":
            zones = [replace(stood, to_m=b + rng.uniform(40, 90))]
        case "not set up":
            zones = []
        case "no drive":
            zones = zones if rng.random() < 0.5 else []
        case "half covered":  # drives turn off in the middle
            covered = (0.0, 400.0)
            where = rng.integers(3)
            zones = [] if where == 0 else [replace(stood, **({"to_m": 385.0} if where == 1 else {"from_m": 430.0}))]
        case "touching" | "touching, one not set up":
            later = replace(
                permit, from_m=permit.to_m, to_m=permit.to_m + length_m, zone=1, end_ns=end_ns + 2 * NIGHT_NS
            )
            other = replace(
                stood, from_m=permit.to_m + 2, to_m=permit.to_m + length_m, end_ns=stood.end_ns + 2 * NIGHT_NS
            )
            zones = [replace(stood, to_m=permit.to_m - 2), other]
            permits = [permit, later]
            if case != "touching":
                zones, permits = [other], [replace(permit, zone=None), replace(later, zone=0)]
        case "beside another's permit":  # a zone without permit 40 m from one that stands as permitted
            zones = [stood, replace(stood, offset_m=-40.0)]
    passes = []
    for night in range(nights):
        at_ns = START_NS + night * NIGHT_NS + round(rng.uniform(0, 6) * HOUR_NS)
        absent = case == "no drive" and begin_ns < at_ns < end_ns
        if rng.random() < 0.7 and not absent:
            passes.append(Pass(at_ns, *covered))
            if case == "beside another's permit":  # the other carriageway
                passes.append(Pass(at_ns + 300_000_000_000, 0.0, 800.0))
    site = Site(number, case, line_m, zones, permits, passes)
    site.expected = expected_of(site)
    return site


def expected_of(site: Site) -> Counter[tuple[str, K]]:
    """Rows by plan (of zones without permit by the site)."""
    rows: Counter[tuple[str, K]] = Counter()
    for number, permit in enumerate(site.permits):
        name = f"{site.number}-{number}"
        zone = None if permit.zone is None or permit.zone >= len(site.zones) else site.zones[permit.zone]
        kinds = set() if zone is None else kinds_of(site, zone, permit)
        if not kinds:
            in_time = [one for one in site.passes if permit.begin_ns <= one.at_ns <= permit.end_ns]
            shares = [Stood(0, 0, permit.from_m, permit.to_m).passed(one) for one in in_time]
            near = abs(permit.offset_m) < PLANS.look_aside_m
            kinds = {K.NOT_FOUND if near and max(shares, default=0.0) > 0.95 else K.NOT_LOOKED}
        rows.update((name, kind) for kind in kinds)
    permitted = {permit.zone for permit in site.permits}
    for number, zone in enumerate(site.zones):
        if number not in permitted and any(seen(zone, one) for one in site.passes):
            rows[f"{site.number}", K.NO_PERMIT] += 1
    return rows


def seen(zone: Stood, one: Pass) -> bool:
    return zone.begin_ns <= one.at_ns <= zone.end_ns and zone.passed(one) * (zone.to_m - zone.from_m) > 20


def kinds_of(site: Site, zone: Stood, permit: Permit) -> set[K]:
    sightings = [one.at_ns for one in site.passes if seen(zone, one)]
    if not sightings:
        return set()
    kinds = {"shifted along": {K.ELSEWHERE}, "shifted across": {K.ELSEWHERE}, "longer": {K.LONGER}}.get(
        site.case, set()
    )
    kinds = kinds | ({K.OTHER_LANES} if zone.offset_m > 0 else set())
    kinds |= {K.EARLY} if min(sightings) < permit.begin_ns - SLACK_NS else set()
    kinds |= {K.OVERRUN} if max(sightings) > permit.end_ns + SLACK_NS else set()
    gone = [one.at_ns for one in site.passes if one.at_ns > zone.end_ns and zone.passed(one) > 0.9]
    if gone and gone[0] < permit.end_ns - SLACK_NS and site.case != "shifted across":
        kinds |= {K.ENDED_EARLY}
    return kinds or {K.PERMITTED}


def zones_of(site: Site, rng: np.random.Generator) -> list[FoundZone]:
    """Those that a map would hold: devices as drives saw them, as zones over time."""
    versions = []
    for zone in site.zones:
        for station_m in np.arange(zone.from_m + 1, zone.to_m, rng.uniform(5, 8)):
            by = [one for one in site.passes if one.from_m <= station_m <= one.to_m]
            there = [one.at_ns for one in by if zone.begin_ns <= one.at_ns <= zone.end_ns]
            found = [ns for ns in there if rng.random() < 0.97]
            if not found:
                continue
            gone = next((one.at_ns for one in by if one.at_ns > zone.end_ns), None)
            at_m = locate(site.line_m, np.array([station_m]), np.array([zone.offset_m]))[0] + rng.normal(0, 0.05, 2)
            number = 10_000 * site.number + len(versions)
            times = {"first_seen_ns": found[0], "last_seen_ns": found[-1]}
            feature = cone(number, at_m, 0.05).model_copy(update=times)
            shared = {"suppressed": False, "version_from_ns": found[0]}
            versions.append(
                FeatureVersion(feature=feature, changeset_id=uuid5(_NAMES, f"{found[0]}"), present=True, valid_from_ns=found[0],
                    valid_to_ns=gone, **shared)
            )  # fmt: skip
            if gone is not None:
                versions.append(versions[-1].model_copy(update={"changeset_id": uuid5(_NAMES, f"{gone}"), "present": False,
                    "valid_from_ns": gone, "valid_to_ns": None}))  # fmt: skip
    paths = [DrivePath(one.drive_id, int(one.at_ns[0]), one.xy_m) for one in drives_of(site)]
    histories = zones_over_time(versions, paths, ZONES, map_name="city")
    return [found_zone(describe(one, layout_of(one, paths, (), ZONES), ZONES), ZONES) for one in histories]


def drives_of(site: Site) -> list[DriveFrames]:
    drives = []
    for number, one in enumerate(site.passes):
        rng = np.random.default_rng([site.number, number])
        stations = np.arange(one.from_m, one.to_m, 3.0)
        other = site.case == "beside another's permit" and number % 2
        offsets = np.full(len(stations), rng.normal(0, 0.3) - 37.5 * bool(other))
        xy_m = locate(site.line_m, stations, offsets) + rng.normal(0, 0.05, (len(stations), 2))
        at_ns = one.at_ns + (np.arange(len(stations)) * 200_000_000).astype(np.int64)
        drives.append(DriveFrames(f"{site.number}-{number}", np.arange(len(stations)), at_ns, xy_m))
    return drives


def plans_of(site: Site) -> list[PlacedPlan]:
    placed = []
    for number, permit in enumerate(site.permits):
        days = range((permit.begin_ns - START_NS) // NIGHT_NS, (permit.end_ns - START_NS) // NIGHT_NS + 1)
        nights = [START_NS + day * NIGHT_NS for day in days]
        periods = [{"starts_at": utc_from_ns(ns - HOUR_NS), "ends_at": utc_from_ns(ns + 8 * HOUR_NS)} for ns in nights]
        plan = PlannedZone(
            plan_id=f"{site.number}-{number}", kind="permit", starts_at=utc_from_ns(permit.begin_ns),
            ends_at=utc_from_ns(permit.end_ns), periods=periods if permit.nightly else (), parts=(((0.0, 0.0),),),
            lanes=("right lane",),
        )  # fmt: skip
        stations = np.linspace(permit.from_m, permit.to_m, 4)
        placed.append(
            PlacedPlan("permits", plan, shape_of([locate(site.line_m, stations, np.full(4, permit.offset_m))]))
        )
    return placed


class Score(NamedTuple):
    precision: float
    recall: float
    not_looked_called_not_found: int
    rows: int
    wrong: list[str]
    differences: list[Difference]


def city_of(sites: int, nights: int, seed: int) -> list[Site]:
    rng = np.random.default_rng([67, seed])
    return [make_site(number, CASES[number % len(CASES)], nights, rng) for number in range(sites)]


def score(sites: int, nights: int, seed: int, params: PlanParams = PLANS) -> Score:
    """Rows of the comparison against what drives could find out."""
    city = city_of(sites, nights, seed)
    rng = np.random.default_rng([68, seed])
    zones = [zone for site in city for zone in zones_of(site, rng)]
    plans = [plan for site in city for plan in plans_of(site)]
    drives = [drive for site in city for drive in drives_of(site)]
    rows = compare(plans, zones, drives, params, at_ns=START_NS + nights * NIGHT_NS)
    middles = np.array([site.line_m.mean(axis=0) for site in city])
    found: Counter[tuple[str, K]] = Counter()
    for row in rows:
        site = int(np.argmin(np.hypot(*(middles - row.xy_m).T)))
        found[row.plan_id or str(site), row.kind] += 1
    expected = sum((site.expected for site in city), Counter())
    right = (found & expected).total()
    cases = {str(site.number): site.case for site in city}
    wrong = [
        f"seed {seed}, {cases[name.split('-')[0]]}, {name}: {'found' if some is found else 'expected'} {kind}"
        for some, other in ((found, expected), (expected, found))
        for name, kind in some - other
    ]
    confused = sum(expected[name, K.NOT_LOOKED] for name, kind in found if kind is K.NOT_FOUND)
    return Score(right / found.total(), right / expected.total(), confused, expected.total(), sorted(wrong), rows)
