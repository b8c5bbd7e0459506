"""Check of a work zone's layout against rules, with uncertainty: spacing, missing cones, taper lengths, cones in the open lane.

The rules of published standards, with the source of each number, are in `rules/*.yaml`. Stations and offsets are those of the
zone's axis, in the direction of travel. A gap across the end of a taper is measured by both limits: the shares of the allowed
spacing that it uses in taper and tangent are added.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import read_yaml_model
from conetl.geometry.linear_reference import locate, spacing_beside
from conetl.model.arrays import Floats
from conetl.model.base import Record
from conetl.model.work_zone_params import LayoutParams, WorkZoneParams
from conetl.model.work_zone_records import ConeRow, LayoutFinding, Level, Rule, Taper, ZoneHistory, ZoneLayout
from conetl.workzones.road_lines import lanes_at

FOOT_M = 0.3048
MILE_KM = 1.609344
NO_NORM_SPACING = "no standard: the row's own spacing"
NO_NORM_IN_LANE = "no standard: distance from the row"
NO_NORM = "no standard: own rules"
#: Tolerance of a taper's ends at lane lines.
_ON_LANE_LINE_M = 0.6
_FOLDER = Path(__file__).with_name("rules")
STANDARDS = tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))
DEFAULT = "mutcd_2023"


def taper_ratio(speed_kmh: float, rules: LayoutParams) -> float:
    """L / W of a merging taper: S^2 / 60 or S, with S in mph (L and W in the same unit)."""
    speed_mph = speed_kmh / MILE_KM
    # Tolerance for the conversion: 72.42048 km/h are 45 mph.
    slow = speed_mph < rules.low_speed_max_mph - 1e-6
    return speed_mph**2 / rules.low_speed_divisor if slow else speed_mph


def allowed_spacing_m(speed_kmh: float, rules: LayoutParams) -> tuple[float, float]:
    """Largest spacing in a taper and in a tangent; infinite without a rule."""
    speed_mph = speed_kmh / MILE_KM
    taper, tangent = rules.taper_spacing_ft_per_mph, rules.tangent_spacing_ft_per_mph
    return (
        math.inf if taper is None else taper * speed_mph * FOOT_M,
        math.inf if tangent is None else tangent * speed_mph * FOOT_M,
    )


def _certain_level(norm: str | None) -> Level:
    """Level of a finding that certainly exceeds a limit; norm: the rule that sets the limit, if any."""
    return Level.VIOLATION if norm else Level.DEVIATION


def check_layout(
    zone: ZoneHistory, layout: ZoneLayout, speed_kmh: float, rules: LayoutParams, params: WorkZoneParams
) -> list[LayoutFinding]:
    """All findings of one zone, by station; none for a zone without a row."""
    check = _Check(zone, layout, speed_kmh, rules, params)
    found = [finding for row in layout.rows for finding in _gaps(check, row)]
    if layout.rows:
        found += [*_taper_lengths(check, layout.rows[0]), *_in_lane(check)]
    return sorted(found, key=lambda finding: (finding.station_m, finding.rule))


class _Check(NamedTuple):
    """The arguments of `check_layout`."""

    zone: ZoneHistory
    layout: ZoneLayout
    speed_kmh: float
    rules: LayoutParams
    params: WorkZoneParams

    def finding(self, members: Iterable[int], **values: Any) -> LayoutFinding:
        """A finding in metres about these cones of the layout."""
        cones = [self.layout.cones[k] for k in members]
        values.setdefault("xy_m", tuple((cone.xyz_m[0], cone.xyz_m[1]) for cone in cones))
        feature_ids = tuple(cone.feature_id for cone in cones)
        return LayoutFinding(zone_id=self.zone.zone_id, unit="m", feature_ids=feature_ids, **values)


def _gaps(check: _Check, row: ConeRow) -> Iterator[LayoutFinding]:
    layout, rules, speed_kmh = check.layout, check.rules, check.speed_kmh
    members = np.array(row.members)
    s, sigma = layout.stations_m[members], layout.sigmas_s_m[members]
    gaps = np.hypot(*np.diff([layout.cones[k].xyz_m[:2] for k in members], axis=0).T)
    shares = np.array([_taper_share(row.tapers, a, b) for a, b in pairwise(s)]).reshape(-1, 2)
    # Crews set a cone at the end of a taper: a gap measured from there gets a notice if lane lines locate it.
    at_cones = np.array([[_share_at_cones(row.tapers, a, b), 0.0] for a, b in pairwise(s)]).reshape(-1, 2)
    limits = allowed_spacing_m(speed_kmh, rules)
    on_lanes = layout.axis_source == "lanes"
    for index, gap in enumerate(gaps):
        both = sigma[index : index + 2]
        read = _read_gap(gaps, shares, index, both, limits, rules, vague=not on_lanes)
        # Too long even for a tangent, wherever the taper ends.
        sure = read.exceeds or gap - max(limits) > rules.sigmas * float(np.hypot(*both))
        noted, doubt = read.lacks, ""
        if on_lanes and not sure and not noted:
            marked = _read_gap(gaps, at_cones, index, both, limits, rules, vague=False)
            if marked.exceeds or marked.lacks:
                read, noted, doubt = marked, True, ", if a cone marks where the taper ends"
        if not sure and not noted and read.used <= 1:
            continue
        lacks = read.lacks or (sure and read.own > rules.missing_cone_ratio)
        where, limit_m = "taper" if read.inside > 0.5 else "tangent", read.limit_m
        norm = rules.sources.get(f"{where}_spacing_ft_per_mph")
        level = _certain_level(norm) if sure else Level.NOTICE if noted else Level.CANNOT_TELL
        if not math.isfinite(limit_m):  # the only rule is the row's own spacing
            limit_m = gap / read.own * rules.missing_cone_ratio
        words = f"{gap:.1f} m from cone to cone in the {where}, at most {limit_m:.1f} m at {speed_kmh:g} km/h{doubt}"
        if lacks:
            missing = max(round(read.own) - 1, 1)
            some = "a cone is" if missing == 1 else f"{missing} cones are"
            rest = (
                f"gap of {gap:.1f} m where the row has {gap / read.own:.1f} m, at most {limit_m:.1f} m allowed{doubt}"
            )
            words = f"{some} missing in the {where}: {rest}"
        yield check.finding(
            members[index : index + 2],
            rule=Rule.MISSING_CONE if lacks else Rule.SPACING,
            level=level,
            norm=NO_NORM_SPACING if level is Level.NOTICE and not read.exceeds else norm or NO_NORM,
            text=words,
            value=float(gap),
            limit=float(limit_m),
            sigma=float(read.sigma * limit_m) or float(np.hypot(*both)),
            station_m=float((s[index] + s[index + 1]) / 2),
        )


class _Gap(NamedTuple):
    """A gap under one assumption about the ends of tapers."""

    inside: float
    """Share of it inside tapers."""
    used: float
    """Share of the allowed spacing that it uses."""
    sigma: float
    limit_m: float
    """Length that would use all of it."""
    own: float
    """Share of the row's own spacing that it uses; 0 if the row is too short to have one."""
    exceeds: bool
    lacks: bool
    """By more than the uncertainty explains: whether it is longer than the rule allows; whether a cone is missing."""


def _read_gap(
    gaps: Floats,
    shares: Floats,
    index: int,
    sigmas_m: Floats,
    limits: tuple[float, float],
    rules: LayoutParams,
    *,
    vague: bool,
) -> _Gap:
    """Compare one gap of a row with the rule and with the row; vague: the ends of tapers are poorly known."""
    gap, (inside, blur_m) = float(gaps[index]), shares[index]
    used, sigma, limit_m = _used(gap, inside, blur_m, sigmas_m, limits)
    regular = _regular(gaps, shares[:, 0], index)
    own, sigma_own, _ = _used(gap, inside, blur_m, sigmas_m, regular) if regular else (0.0, 1.0, 0.0)
    if vague:  # twice the spacing before it may be the spacing behind it
        own = min(own, gap / max(spacing_beside(gaps, index, alone=np.inf), 1e-9))
    exceeds = used - 1.0 > rules.sigmas * sigma
    lacks = own - rules.missing_cone_ratio > rules.sigmas * sigma_own
    return _Gap(float(inside), used, sigma, limit_m, own, exceeds, lacks)


def _share_at_cones(tapers: Sequence[Taper], from_m: float, to_m: float) -> float:
    """Least share of a gap inside tapers, if a cone marks each of their ends."""
    inside_m = sum(max(min(to_m, *taper.end.cones_m) - max(from_m, *taper.start.cones_m), 0.0) for taper in tapers)
    return min(inside_m / (to_m - from_m), 1.0) if to_m > from_m else 0.0


def _taper_share(tapers: Sequence[Taper], from_m: float, to_m: float) -> tuple[float, float]:
    """Share of a gap that is inside tapers, and one sigma of it towards less (m), which allows a wider gap."""
    inside_m, blur_m = 0.0, 0.0
    for taper in tapers:
        inside_m += max(min(to_m, taper.end.station_m) - max(from_m, taper.start.station_m), 0.0)
        for knot, sigma_m in ((taper.start, taper.start.sigmas_m[1]), (taper.end, taper.end.sigmas_m[0])):
            if from_m - 2 * sigma_m < knot.station_m < to_m + 2 * sigma_m:
                blur_m = max(blur_m, min(sigma_m, to_m - from_m))
    length = to_m - from_m
    return (min(inside_m / length, 1.0) if length > 0 else 0.0), blur_m


def _used(
    gap_m: float, inside: float, blur_m: float, sigmas_m: Floats, spacing_m: tuple[float, float]
) -> tuple[float, float, float]:
    """Share of the spacing that a gap uses, its sigma, and the length that would use all of it."""
    taper_m, tangent_m = spacing_m
    rate = inside / taper_m + (1 - inside) / tangent_m
    sigma = float(np.hypot(np.hypot(*sigmas_m) * rate, blur_m * abs(1 / taper_m - 1 / tangent_m)))
    return gap_m * rate, sigma, 1 / rate if rate else math.inf


def _regular(gaps: Floats, inside: Floats, index: int) -> tuple[float, float] | None:
    """The row's own spacing in tapers and in tangents, without this gap; None if the row is too short."""
    others = np.arange(len(gaps)) != index
    medians = []
    for kind in (inside > 0.95, inside < 0.05):
        chosen = gaps[others & kind]
        medians.append(float(np.median(chosen)) if len(chosen) >= 2 else None)
    taper, tangent = medians
    if inside[index] > 0.95:
        return None if taper is None else (taper, taper)
    if inside[index] < 0.05:
        return None if tangent is None else (tangent, tangent)
    if taper is None or tangent is None:
        only = taper or tangent
        # A tangent has up to twice the spacing of its taper: the larger value avoids false missing cones.
        return None if only is None else (only, 2 * only if tangent is None else only)
    return taper, tangent


def _taper_lengths(check: _Check, row: ConeRow) -> Iterator[LayoutFinding]:
    layout, rules = check.layout, check.rules
    ratio = taper_ratio(check.speed_kmh, rules)
    members = np.array(row.members)
    for taper in row.tapers:
        if not taper.converging or not layout.direction_known or layout.traffic_side is None:
            continue
        length_m = taper.length_m
        shift_sigma = float(np.hypot(taper.shift_sigma_m, layout.axis_sigma_m))
        merging = _is_merging(layout, taper, members, check.params)
        for share, kind in ((rules.shoulder_taper_share, "shoulder"), (rules.merging_taper_share, "merging")):
            if share is None:
                continue
            wanted_m = share * ratio * taper.shift_m
            longer_m = np.hypot(taper.start.sigmas_m[0], taper.end.sigmas_m[1])
            sigma_m = float(np.hypot(longer_m, share * ratio * shift_sigma))
            if length_m >= wanted_m or (merging if kind == "shoulder" else merging is False):
                continue
            sure = wanted_m - length_m > rules.sigmas * sigma_m and (kind == "shoulder" or merging is True)
            doubt = "" if merging is not None or kind == "shoulder" else " if it closes a lane"
            norm = rules.sources.get(f"{kind}_taper_share")
            yield check.finding(
                members[[taper.first, taper.last]],
                rule=Rule.TAPER_LENGTH,
                level=_certain_level(norm) if sure else Level.CANNOT_TELL,
                norm=norm or NO_NORM,
                text=f"taper of {length_m:.1f} m over {taper.shift_m:.1f} m of width, a {kind} taper needs {wanted_m:.1f} m "
                f"at {check.speed_kmh:g} km/h{doubt}",
                value=length_m,
                limit=wanted_m,
                sigma=sigma_m,
                station_m=(taper.start.station_m + taper.end.station_m) / 2,
            )
            break


def _is_merging(layout: ZoneLayout, taper: Taper, members: Floats, params: WorkZoneParams) -> bool | None:
    """Whether the taper closes a lane, or is a shoulder taper, which ends at the edge of all lanes; None if lane lines do not
    decide."""
    if layout.bands is None or layout.axis_source != "lanes":
        sigma = float(np.hypot(taper.shift_sigma_m, layout.axis_sigma_m))
        return True if taper.shift_m - 2 * sigma >= params.full_lane_shift_m else None
    sign = 1.0 if layout.traffic_side == "left" else -1.0
    end = int(members[taper.last])
    offset = layout.offsets_m[end] * sign
    lanes = lanes_at(layout.bands, float(layout.stations_m[end]), params)
    if not lanes:
        return None
    edges = [sorted((a * sign, b * sign)) for a, b in lanes]
    return bool(min(low for low, _ in edges) + _ON_LANE_LINE_M < offset)


def _in_lane(check: _Check) -> Iterator[LayoutFinding]:
    """Strays on the traffic side of their row."""
    layout, rules = check.layout, check.rules
    in_rows = {k for row in layout.rows for k in row.members}
    for k in range(len(layout.cones)):
        if k in in_rows:
            continue
        station, offset = float(layout.stations_m[k]), float(layout.offsets_m[k])
        rows = [list(row.members) for row in layout.rows]
        beside = [float(np.interp(station, layout.stations_m[row], layout.offsets_m[row])) for row in rows]
        nearest = min(beside, key=lambda value: abs(offset - value))
        sign = {"left": 1.0, "right": -1.0, None: float(np.sign(offset - nearest))}[layout.traffic_side]
        away = (offset - nearest) * sign
        if away <= rules.in_lane_tolerance_m:
            continue
        sigma = float(np.hypot(layout.sigmas_o_m[k], np.median(layout.sigmas_o_m)))
        sure = away - rules.in_lane_tolerance_m > rules.sigmas * sigma and layout.traffic_side is not None
        x_m, y_m = locate(layout.axis_m, np.array([station]), np.array([offset]))[0]
        doubt = "" if layout.traffic_side is not None else "; the side on which traffic passes is unknown"
        yield check.finding(
            [k],
            rule=Rule.CONE_IN_LANE,
            level=_certain_level(rules.sources.get("in_lane_tolerance_m")) if sure else Level.CANNOT_TELL,
            norm=rules.sources.get("in_lane_tolerance_m", NO_NORM_IN_LANE),
            text=f"a cone stands {away:.2f} m from its row towards traffic{doubt}",
            value=away,
            limit=rules.in_lane_tolerance_m,
            sigma=sigma,
            station_m=station,
            xy_m=((float(x_m), float(y_m)),),
        )


class CitedRule(Record):
    """One number of a standard."""

    value: float
    source: str
    """Section or table."""
    text: str


class Standard(Record):
    """One standard: its numbers by the names of `LayoutParams`."""

    standard: str
    """Name and edition."""
    rules: dict[str, CitedRule]
    not_covered: tuple[str, ...] = ()


@cache
def read_standard(name: str) -> Standard:
    """One of `STANDARDS`."""
    return read_yaml_model(_FOLDER / f"{name}.yaml", Standard, "standard")


def layout_rules(name: str = DEFAULT, own: LayoutParams | None = None) -> LayoutParams:
    """The rules of a standard, overridden by the values of `own` that were set; these have only the sources of `own.sources`."""
    standard = read_standard(name)
    values: dict[str, object] = {key: rule.value for key, rule in standard.rules.items()}
    sources = {key: f"{standard.standard}, {rule.source}" for key, rule in standard.rules.items()}
    if own is not None:
        set_here = own.model_dump(include=own.model_fields_set - {"sources"})
        values |= set_here
        sources = {key: text for key, text in sources.items() if key not in set_here} | own.sources
    return LayoutParams.model_validate(values | {"sources": sources})
