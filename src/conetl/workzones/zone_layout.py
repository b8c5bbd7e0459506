"""The layout of a work zone along its road: direction of travel, rows, tapers, closed side and lanes, line and ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conetl.geometry.linear_reference import directions_at, locate, project
from conetl.geometry.packing import cov_matrices
from conetl.model.arrays import Floats
from conetl.model.map_records import MapFeature
from conetl.model.rig import Side
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import (
    AxisSource,
    DrivePath,
    LaneBands,
    LaneLine,
    VehicleImpact,
    WorkZone,
    ZoneHistory,
    ZoneLayout,
)
from conetl.workzones.cone_rows import find_rows
from conetl.workzones.road_lines import axes_of, closed_lanes, lane_bands, passes_beside

#: Lane lines are searched this far beside the cones, and before the first and behind the last one.
_LANE_REACH_M = 15.0
_LANE_MARGIN_M = 10.0


def layout_of(
    zone: ZoneHistory, paths: Sequence[DrivePath], lanes: Sequence[LaneLine], params: WorkZoneParams
) -> ZoneLayout:
    """The zone in the direction of travel; paths: of drives up to the instant of interest.

    The direction is that of the drives. If they came from both sides, the one whose drivers had the cones on the kerb side; if
    that does not decide, the one in which the row converges; then the one that passed nearest.
    """
    cones_m = np.array([cone.xyz_m[:2] for cone in zone.cones])
    until = zone.end_ns
    passes = passes_beside([p for p in paths if until is None or p.captured_from_ns <= until], cones_m, params)
    axis = axes_of(cones_m, passes, params)[0]
    line, source = axis.line_m, axis.source
    passes = passes if source == "drives" else []
    known = bool(passes)
    if known and _direction(line, cones_m, zone.cones, passes, params) < 0:
        line = line[::-1]
    if source == "drives" and not _are_of_road(lanes, line, cones_m, params):
        lanes = ()
    reference = _lane_axis(line, cones_m, lanes) if lanes else None
    if reference is not None:
        line, source = reference, "lanes"
    return _layout_along(line, source, known, zone.cones, passes, lanes, params)


def describe(history: ZoneHistory, layout: ZoneLayout, params: WorkZoneParams) -> WorkZone:
    """The zone as published, as far as the evidence allows."""
    first, last = layout.cones[0], layout.cones[-1]
    row = list(layout.rows[0].members) if layout.rows else list(range(len(layout.cones)))
    through = sorted({0, *row, len(layout.cones) - 1})
    if len(through) == 1:  # what is left of a zone that is removed: a line of one position is none in any format
        through *= 2
    closed_side: Side | None = None
    if layout.traffic_side is not None:
        closed_side = "right" if layout.traffic_side == "left" else "left"
    impact, lane_count = _impact(layout, row, closed_side, params)
    return WorkZone(
        history=history,
        layout=layout,
        line_m=np.array([layout.cones[k].xyz_m for k in through]),
        first=first,
        last=last,
        impact=impact,
        closed_side=closed_side,
        closed_lane_count=lane_count,
    )


def _layout_along(
    line: Floats,
    source: AxisSource,
    known: bool,
    cones: Sequence[MapFeature],
    passes: Sequence[DrivePath],
    lanes: Sequence[LaneLine],
    params: WorkZoneParams,
) -> ZoneLayout:
    cones_m = np.array([cone.xyz_m[:2] for cone in cones])
    s, o = project(line, cones_m)
    order = np.argsort(s, kind="stable")
    s, o, ordered = s[order], o[order], tuple(cones[k] for k in order)
    sigma_s, sigma_o = _sigmas(line, s, ordered)
    with_traffic = [one for one in passes if _heading(line, one) > 0] or list(passes)
    axis_sigma_m = params.lane_axis_sigma_m if source == "lanes" else params.path_axis_sigma_m
    rows = find_rows(s, o, sigma_s, sigma_o, params, traffic_sign=0.0, axis_sigma_m=axis_sigma_m)
    sign = _traffic_sign(line, with_traffic, s, o, rows[0].members if rows else ())
    if sign:
        rows = find_rows(s, o, sigma_s, sigma_o, params, traffic_sign=sign, axis_sigma_m=axis_sigma_m)
    bands = _bands(line, s, lanes) if lanes else None
    return ZoneLayout(
        axis_m=line,
        axis_source=source,
        axis_sigma_m=axis_sigma_m,
        direction_known=known,
        cones=ordered,
        stations_m=s,
        offsets_m=o,
        sigmas_s_m=sigma_s,
        sigmas_o_m=sigma_o,
        rows=tuple(rows),
        traffic_side=None if not sign else ("left" if sign > 0 else "right"),
        bands=bands,
        two_way=len({_heading(line, one) for one in passes}) > 1,
        drive_ids=tuple(sorted({one.drive_id for one in passes})),
    )


def _bands(line: Floats, s: Floats, lanes: Sequence[LaneLine]) -> LaneBands | None:
    return lane_bands(
        line, lanes, from_m=float(s[0]) - _LANE_MARGIN_M, to_m=float(s[-1]) + _LANE_MARGIN_M, reach_m=_LANE_REACH_M
    )


def _sigmas(line: Floats, s: Floats, cones: Sequence[MapFeature]) -> tuple[Floats, Floats]:
    """Sigmas (C,) of cones along and across the line, from their covariances."""
    along = directions_at(line, s)
    axes = np.stack([along, along[:, ::-1] * [-1.0, 1.0]], axis=1)
    cov = cov_matrices([cone.cov_m2 for cone in cones])[:, :2, :2]
    sigma_s, sigma_o = np.sqrt(np.maximum(np.einsum("cki,cij,ckj->kc", axes, cov, axes), 0.0))
    return sigma_s, sigma_o


def _heading(line: Floats, one: DrivePath) -> int:
    s, _ = project(line, one.xy_m[[0, -1]])
    return 1 if s[1] > s[0] else -1


def _direction(
    line: Floats, cones_m: Floats, cones: Sequence[MapFeature], passes: Sequence[DrivePath], params: WorkZoneParams
) -> int:
    """+1 if traffic follows the line, -1 against it."""
    kerb_sign = -1.0 if params.kerb_side == "right" else 1.0
    scores: dict[int, tuple[bool, bool, float]] = {}
    for heading in (1, -1):
        those = [one for one in passes if _heading(line, one) == heading]
        if not those:
            continue
        beside = [float(np.median(project(one.xy_m, cones_m)[1])) for one in those]
        kerb = sum(value * kerb_sign > 0 for value in beside) * 2 > len(beside)
        layout = _layout_along(line[::heading], "drives", True, cones, those, (), params)
        tapers = layout.rows[0].tapers if layout.rows else ()
        scores[heading] = (kerb, bool(tapers) and tapers[0].converging, -min(abs(value) for value in beside))
    return max(scores, key=lambda heading: (scores[heading], heading))


def _traffic_sign(line: Floats, passes: Sequence[DrivePath], s: Floats, o: Floats, row: Sequence[int]) -> float:
    """+1 if traffic passed to the left of the row, -1 to the right, 0 unknown."""
    if not passes or not row:
        return 0.0
    sides = []
    for one in passes:
        pass_s, pass_o = project(line, one.xy_m)
        order = np.argsort(pass_s)
        sides += list(np.interp(s[list(row)], pass_s[order], pass_o[order]) - o[list(row)])
    return float(np.sign(np.median(sides)))


def _are_of_road(lanes: Sequence[LaneLine], driven: Floats, cones_m: Floats, params: WorkZoneParams) -> bool:
    """Whether a vehicle on the path was in a lane of these lines: in their reach, and within a lane's width of one of them."""
    bands = _bands(driven, np.sort(project(driven, cones_m)[0]), lanes) if lanes else None
    return bands is not None and float(np.nanmin(np.abs(bands.offsets_m))) <= params.lane_width_m[1]


def _lane_axis(line: Floats, cones_m: Floats, lanes: Sequence[LaneLine]) -> Floats | None:
    """The lane line nearest to the cones that runs beside all of them, in the direction of `line`; None if there is none."""
    s, o = project(line, cones_m)
    bands = _bands(line, np.sort(s), lanes)
    if bands is None:
        return None
    beside = []
    for number, offsets_m in enumerate(bands.offsets_m.T):
        there = np.isfinite(offsets_m)
        at, aside_m = bands.stations_m[there], offsets_m[there]
        if at[0] <= s.min() and at[-1] >= s.max():
            beside.append((float(np.median(np.abs(np.interp(s, at, aside_m) - o))), number, at, aside_m))
    if not beside:
        return None
    _, _, at, aside_m = min(beside)
    return locate(line, at, aside_m)


def _impact(
    layout: ZoneLayout, row: Sequence[int], closed_side: Side | None, params: WorkZoneParams
) -> tuple[VehicleImpact, int | None]:
    """Impact and number of closed lanes; UNKNOWN and None if the evidence does not decide."""
    if closed_side is None or not layout.direction_known:
        return VehicleImpact.UNKNOWN, None
    converging = [taper for taper in layout.rows[0].tapers if taper.converging]
    merge = VehicleImpact.SOME_LANES_CLOSED_MERGE_RIGHT
    if layout.two_way:
        merge = VehicleImpact.SOME_LANES_CLOSED
    elif closed_side == "right":
        merge = VehicleImpact.SOME_LANES_CLOSED_MERGE_LEFT
    if layout.bands is not None and layout.axis_source == "lanes":
        sign = 1.0 if layout.traffic_side == "left" else -1.0
        some = np.array(row)
        closed, narrowed = closed_lanes(
            layout.bands, layout.stations_m[some], layout.offsets_m[some], layout.sigmas_o_m[some], sign, params
        )
        if closed:
            return (merge if converging else VehicleImpact.SOME_LANES_CLOSED), closed
        return (VehicleImpact.UNKNOWN, None) if narrowed else (VehicleImpact.ALL_LANES_OPEN, 0)
    for taper in converging:
        sigma = float(np.hypot(taper.shift_sigma_m, layout.axis_sigma_m))
        if taper.shift_m - 2 * sigma >= params.full_lane_shift_m:
            return merge, None
    return VehicleImpact.UNKNOWN, None
