"""A city of work zones over nights, with permits that differ in known ways, and what drives could find out about each.

Streets, drives, devices and permits are simulated; zones are made of the devices as on a map, and compared by the real code. What
is expected of each permit follows from the simulated passes alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
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
ZONES, PLANS = WorkZoneParams(), PlanParams()
_NAMES = UUID(int=67)
_LENGTH_M = 800.0


class Pass(NamedTuple):
    """A drive along a street, between two stations, without images between two others."""

    at_ns: int
    from_m: float
    to_m: float
    gap_m: tuple[float, float]
    offset_m: float = 0.0

    def at(self, stations_m: np.ndarray) -> np.ndarray:
        """Which stations it passed with images."""
        gap = (stations_m > self.gap_m[0]) & (stations_m < self.gap_m[1])
        return (stations_m >= self.from_m) & (stations_m <= self.to_m) & ~gap


@dataclass(frozen=True)
class Stood:
    """A zone as it really stood, to the left of the driven path by offset_m; without a permit permit is None."""

    begin_ns: int
    end_ns: int
    from_m: float
    to_m: float
    offset_m: float = -2.5
    permit: int | None = 0

    @property
    def grid_m(self) -> np.ndarray:
        return np.arange(self.from_m + 1, self.to_m, 4.0)


@dataclass(frozen=True)
class Permit:
    """Stations, and offset to the left of the driven path."""

    begin_ns: int
    end_ns: int
    from_m: float
    to_m: float
    offset_m: float
    nightly: bool = False
    form: str = "line"
    """line, area, pieces or rough: its ends only."""


@dataclass
class Site:
    """A street."""

    number: int
    case: str
    line_m: np.ndarray
    zones: list[Stood]
    permits: list[Permit]
    passes: list[Pass] = field(default_factory=list)


def _moved(zone: Stood, **changes: float) -> Stood:
    return replace(zone, **{name: getattr(zone, name) + change for name, change in changes.items()})


def _part(z: Stood, p: Permit, rng: np.random.Generator) -> tuple[list[Stood], list[Permit]]:
    """As permitted, or on a part of the place only."""
    return [z if rng.random() < 0.5 else _moved(z, from_m=(z.to_m - z.from_m) / 2)], [p]


def _half(z: Stood, p: Permit, rng: np.random.Generator) -> tuple[list[Stood], list[Permit]]:
    """Drives turn off at the middle of the street: nothing stands there, or on one side."""
    where = rng.integers(3)
    return [[], [replace(z, to_m=385.0)], [replace(z, from_m=430.0)]][where], [replace(p, form="line")]


def _touching(z: Stood, p: Permit, rng: np.random.Generator) -> tuple[list[Stood], list[Permit]]:
    p = replace(p, form="line")
    later = replace(p, from_m=p.to_m, to_m=p.to_m + 120, end_ns=p.end_ns + 2 * NIGHT_NS)
    other = replace(z, from_m=p.to_m + 2, to_m=p.to_m + 120, end_ns=z.end_ns + 2 * NIGHT_NS, permit=1)
    return [replace(z, to_m=p.to_m - 2), other], [p, later]


def _again(z: Stood, p: Permit, rng: np.random.Generator) -> tuple[list[Stood], list[Permit]]:
    """Two permits of one place, one after the other, each with its zone."""
    middle_ns = (p.begin_ns + p.end_ns) // 2
    first_end_ns, second_ns = middle_ns - 30 * HOUR_NS, middle_ns + 30 * HOUR_NS
    zones = [replace(z, end_ns=first_end_ns - HOUR_NS // 4), replace(z, begin_ns=second_ns + HOUR_NS // 4, permit=1)]
    return zones, [replace(p, end_ns=first_end_ns), replace(p, begin_ns=second_ns)]


def _nights(rng: np.random.Generator, most: int = 6) -> int:
    return int(rng.integers(2, most)) * NIGHT_NS


#: Name of a case -> what stands and what is permitted, of a zone that stands as permitted.
MAKERS: dict[str, Callable[[Stood, Permit, np.random.Generator], tuple[list[Stood], list[Permit]]]] = {
    "as permitted": _part,
    "no permit": lambda z, p, rng: ([replace(z, permit=None)], []),
    "ended early": lambda z, p, rng: ([replace(z, end_ns=p.begin_ns + _nights(rng))], [replace(p, nightly=False)]),
    "overrun": lambda z, p, rng: ([_moved(z, end_ns=_nights(rng))], [p]),
    "early": lambda z, p, rng: ([_moved(z, begin_ns=-_nights(rng, 4))], [p]),
    "shifted along": lambda z, p, rng: ([_moved(z, from_m=(s := rng.choice([-30.0, 30.0])), to_m=s)], [p]),
    "shifted across": lambda z, p, rng: ([z], [replace(p, offset_m=z.offset_m + rng.choice([-30.0, 30.0]), form="line")]),
    "wrong lane": lambda z, p, rng: ([replace(z, offset_m=2.5)], [p]),
    "longer": lambda z, p, rng: ([_moved(z, to_m=rng.uniform(40, 90))], [p]),
    "longer and overrun": lambda z, p, rng: ([_moved(z, to_m=rng.uniform(40, 90), end_ns=_nights(rng))], [p]),
    "shifted, early, wrong lane": lambda z, p, rng: (
        [replace(_moved(z, from_m=30, to_m=30, begin_ns=-_nights(rng, 4)), offset_m=2.5)], [p]
    ),
    "not set up": lambda z, p, rng: ([], [p]),
    "no drive": lambda z, p, rng: ([z] if rng.random() < 0.5 else [], [p]),
    "half covered": _half,
    "touching": _touching,
    "touching, one not set up": lambda z, p, rng: (_touching(z, p, rng)[0][1:], _touching(z, p, rng)[1]),
    "another without permit": lambda z, p, rng: (
        [one := _touching(z, p, rng)[0][0], _moved(replace(one, permit=None), from_m=320, to_m=320)], [replace(p, form="line")]
    ),
    "beside another's permit": lambda z, p, rng: ([z, replace(z, offset_m=-40.0, permit=None)], [replace(p, form="line")]),
    "two permits in turn": _again,
    "two records": lambda z, p, rng: ([z], [p, replace(p, nightly=False)]),
}  # fmt: skip
CASES = tuple(MAKERS)


def make_site(number: int, case: str, nights: int, rng: np.random.Generator) -> Site:
    heading, bend = rng.uniform(0, 2 * np.pi), rng.uniform(-1, 1) / 400.0
    stations = np.arange(-100.0, _LENGTH_M + 100, 5.0)
    angles = heading + bend * (stations - _LENGTH_M / 2)
    steps = 5.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    line_m = ORIGIN_M + 2_500.0 * np.array([number % 20, number // 20]) + np.cumsum(steps, axis=0)
    line_m = line_m[stations >= 0]
    length_m, first, last = (
        rng.uniform(60, 200),
        int(rng.integers(3, nights // 3)),
        int(rng.integers(nights // 2, nights - 4)),
    )
    a, b = (_LENGTH_M - length_m) / 2, (_LENGTH_M + length_m) / 2
    begin_ns, end_ns = START_NS + first * NIGHT_NS - 3 * HOUR_NS, START_NS + last * NIGHT_NS + 10 * HOUR_NS
    form = str(rng.choice(["line", "area", "pieces", "rough"], p=[0.6, 0.2, 0.1, 0.1]))
    drawn_m, ends_m = rng.uniform(-5, 5), rng.uniform(-3, 3, 2)
    permit = Permit(begin_ns, end_ns, a + ends_m[0], b + ends_m[1], drawn_m, bool(rng.random() < 0.15), form)
    stood = Stood(begin_ns + round(rng.uniform(0, 2) * HOUR_NS), end_ns - round(rng.uniform(0, 0.4) * HOUR_NS), a, b)
    site = Site(number, case, line_m, *MAKERS[case](stood, permit, rng))
    for night in range(nights):
        at_ns = START_NS + night * NIGHT_NS + round(rng.uniform(0, 6) * HOUR_NS)
        gap_m = (g := rng.uniform(0, _LENGTH_M), g + rng.uniform(30, 80)) if rng.random() < 0.2 else (0.0, 0.0)
        if rng.random() < 0.7 and not (case == "no drive" and begin_ns < at_ns < end_ns):
            turns_m = 400.0 if case == "half covered" else _LENGTH_M
            site.passes.append(Pass(at_ns, 0.0, turns_m, gap_m, float(rng.normal(0, 0.3))))
            if case == "beside another's permit":
                site.passes.append(Pass(at_ns + HOUR_NS // 12, 0.0, _LENGTH_M, gap_m, -37.5))
    return site


def expected_of(site: Site) -> Counter[tuple[str, K]]:
    """Rows by plan, and of zones without permit by the site."""
    rows: Counter[tuple[str, K]] = Counter()
    for number, permit in enumerate(site.permits):
        of = [zone for zone in site.zones if zone.permit == number or (site.case == "two records" and zone.permit == 0)]
        kinds = [kind for zone in of for kind in kinds_of(site, zone, permit)]
        if not kinds:
            grid_m = np.arange(permit.from_m, permit.to_m, 4.0)
            in_time = [one for one in site.passes if permit.begin_ns <= one.at_ns <= permit.end_ns]
            looked = [one.at(grid_m) for one in in_time if abs(one.offset_m - permit.offset_m) < PLANS.look_aside_m]
            share = np.any(looked, axis=0).mean() if looked else 0.0
            kinds = [K.NOT_FOUND if share >= PLANS.least_coverage and permit.form != "rough" else K.NOT_LOOKED]
        rows.update((f"{site.number}-{number}", kind) for kind in kinds)
    rows[f"{site.number}", K.NO_PERMIT] += sum(
        zone.permit is None and bool(sightings(site, zone)) for zone in site.zones
    )
    return +rows


def passes_at(site: Site, zone: Stood) -> list[Pass]:
    return [one for one in site.passes if abs(one.offset_m - zone.offset_m) < PLANS.look_aside_m]


def sightings(site: Site, zone: Stood) -> list[int]:
    """When enough of it was seen."""
    there = [one for one in passes_at(site, zone) if zone.begin_ns <= one.at_ns <= zone.end_ns]
    return [one.at_ns for one in there if 4 * one.at(zone.grid_m).sum() > 20]


def kinds_of(site: Site, zone: Stood, permit: Permit) -> set[K]:
    seen = sightings(site, zone)
    if not seen:
        return set()
    kinds = {K.ELSEWHERE} if "shifted" in site.case else {K.LONGER} if "longer" in site.case else set()
    kinds = set() if permit.form == "rough" else kinds
    kinds |= {K.OTHER_LANES} if zone.offset_m > 0 else set()
    kinds |= {K.EARLY} if min(seen) < permit.begin_ns - SLACK_NS else set()
    kinds |= {K.OVERRUN} if max(seen) > permit.end_ns + SLACK_NS else set()
    after = [one for one in passes_at(site, zone) if one.at_ns > zone.end_ns]
    gone = [min((one.at_ns for one in after if one.at(m)), default=None) for m in zone.grid_m]
    if None not in gone and max(gone) < permit.end_ns - SLACK_NS and site.case != "shifted across":
        kinds |= {K.ENDED_EARLY}
    return kinds or {K.PERMITTED}


def versions_of(site: Site, rng: np.random.Generator) -> list[FeatureVersion]:
    """Devices as drives saw them; each misses some, and there are a few that nobody set up."""
    versions: list[FeatureVersion] = []

    def add(station_m: float, offset_m: float, begin_ns: int, end_ns: int, by: list[Pass]) -> None:
        passed = [one.at_ns for one in by if one.at(np.array([station_m])).all()]
        found = [ns for ns in passed if begin_ns <= ns <= end_ns and rng.random() < 0.92]
        if not found:
            return
        gone = next((ns for ns in passed if ns > end_ns), None)
        at_m = locate(site.line_m, np.array([station_m]), np.array([offset_m]))[0] + rng.normal(0, 0.05, 2)
        feature = cone(10_000 * site.number + len(versions), at_m, 0.05)
        feature = feature.model_copy(update={"first_seen_ns": found[0], "last_seen_ns": found[-1]})
        made = FeatureVersion(
            feature=feature, changeset_id=uuid5(_NAMES, f"{found[0]}"), present=True, suppressed=False,
            version_from_ns=found[0], valid_from_ns=found[0], valid_to_ns=gone,
        )  # fmt: skip
        versions.append(made)
        if gone is not None:
            ended = {
                "changeset_id": uuid5(_NAMES, f"{gone}"),
                "present": False,
                "valid_from_ns": gone,
                "valid_to_ns": None,
            }
            versions.append(made.model_copy(update=ended))

    for zone in site.zones:
        for station_m in np.arange(zone.from_m + 1, zone.to_m, rng.uniform(5, 8)):
            add(float(station_m), zone.offset_m, zone.begin_ns, zone.end_ns, passes_at(site, zone))
    for one in site.passes[:: max(len(site.passes) // 2, 1)]:  # seen once
        add(rng.uniform(0, _LENGTH_M), rng.uniform(-4, 4), one.at_ns, one.at_ns, site.passes)
    return versions


def zones_of(site: Site, rng: np.random.Generator) -> list[FoundZone]:
    """Those that a map would hold."""
    paths = [DrivePath(one.drive_id, int(one.at_ns[0]), one.xy_m) for one in drives_of(site)]
    histories = zones_over_time(versions_of(site, rng), paths, ZONES, map_name="city")
    return [found_zone(describe(one, layout_of(one, paths, (), ZONES), ZONES), ZONES) for one in histories]


def drives_of(site: Site) -> list[DriveFrames]:
    drives = []
    for number, one in enumerate(site.passes):
        rng = np.random.default_rng([site.number, number])
        stations = np.arange(0.0, _LENGTH_M, 3.0)
        stations = stations[one.at(stations)]
        xy_m = locate(site.line_m, stations, np.full(len(stations), one.offset_m))
        xy_m = xy_m + rng.normal(0, 0.05, (len(stations), 2))
        at_ns = one.at_ns + (stations / 12 * 1e9).astype(np.int64)
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
            lanes=("right lane",), approximate=permit.form == "rough",
        )  # fmt: skip
        placed.append(PlacedPlan("permits", plan, shape_of(parts_of(site, permit))))
    return placed


def parts_of(site: Site, permit: Permit) -> list[np.ndarray]:
    stations = np.linspace(permit.from_m, permit.to_m, 5)

    def along(aside_m: float, some: np.ndarray = stations) -> np.ndarray:
        return locate(site.line_m, some, np.full(len(some), permit.offset_m + aside_m))

    if permit.form == "area":
        ring = np.concatenate([along(5.0), along(-5.0)[::-1]])
        return [np.concatenate([ring, ring[:1]])]
    if permit.form == "pieces":
        return [along(0.0, stations[:3]), along(0.0, stations[2:])]
    return [along(0.0, stations[[0, -1]] if permit.form == "rough" else stations)]


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
    expected = sum(map(expected_of, city), Counter())
    right = (found & expected).total()
    cases = {str(site.number): site.case for site in city}
    wrong = [
        f"seed {seed}, {cases[name.split('-')[0]]}, {name}: {'found' if some is found else 'expected'} {kind}"
        for some, other in ((found, expected), (expected, found))
        for name, kind in some - other
    ]
    confused = sum(expected[name, K.NOT_LOOKED] for name, kind in found if kind is K.NOT_FOUND)
    return Score(right / found.total(), right / expected.total(), confused, expected.total(), sorted(wrong), rows)
