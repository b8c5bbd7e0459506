"""Lane markings of a drive or a map against their truth.

Completeness, correctness and redundancy are those of C. Wiedemann, "External Evaluation of Road Networks", ISPRS Archives XXXIV
(3/W8), 2003: shares of length within a buffer. Unlike there, each piece of a found line counts for the nearest marking only, so
that one found line cannot count as both lines of a double marking.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from conetl.files.documents import first_message, library_errors, read_limited
from conetl.geometry.camera import project as image_points
from conetl.geometry.consistency import Consistency, consistency
from conetl.geometry.geodesy import to_map
from conetl.geometry.linear_reference import directions_at, project, resampled, stations
from conetl.geometry.rig import camera_of, map_SE3_camera
from conetl.model.arrays import Bools, Floats
from conetl.model.base import NonNegative, Positive, Record, Vec3
from conetl.model.drive import Drive
from conetl.model.errors import InputError
from conetl.model.markings import Marking, MarkingColour, MarkingPattern

TRUTH_FILE = "truth_markings.geojson"
BUFFER_M = 0.15
#: A dash or gap that differs by no more is the right one: patterns in use differ by 1 m and more.
DASH_TOLERANCE_M = 0.5
_STEP_M = 0.1
#: Where a drive can be expected to show a marking: depth, and distance to the side of the camera.
_DEPTHS_M = (4.0, 15.0)
_ASIDE_M = 8.0
#: Components of the errors of vertices (across the marking, upwards) by name of their NEES.
NEES_PARTS = {"lateral": slice(0, 1), "height": slice(1, 2), "together": slice(0, 2)}


class TruthMarking(Record):
    """One lane marking of the truth: centre line of its paint, in the map's CRS with ellipsoidal heights."""

    marking_id: str
    vertices_m: tuple[Vec3, ...]
    pattern: MarkingPattern
    colour: MarkingColour
    width_m: Positive
    dash_m: Positive | None = None
    gap_m: Positive | None = None
    dash_start_m: NonNegative | None = None
    """Start of the first dash, from the first vertex."""


def read_truth_markings(path: Path, map_srid: int) -> list[TruthMarking]:
    """The markings of a GeoJSON file (WGS 84, ellipsoidal heights). Raises InputError that names file and feature."""
    unreadable = f"truth {path}: cannot be read as a GeoJSON FeatureCollection"
    with library_errors(unreadable, OSError, ValueError, TypeError, KeyError):
        features = json.loads(read_limited(path))["features"]
    markings = []
    for number, feature in enumerate(features, 1):
        try:
            lon, lat, height = np.array(feature["geometry"]["coordinates"], dtype=float).reshape(-1, 3).T
            if len(lon) < 2:
                raise ValueError("a line has at least two points")
            vertices = to_map(map_srid, lat, lon, height).tolist()
            markings.append(TruthMarking.model_validate({**feature["properties"], "vertices_m": vertices}))
        except ValidationError as error:
            raise InputError(f"truth {path}, feature {number}, {first_message(error)}") from error
        except (ValueError, TypeError, KeyError) as error:
            raise InputError(f"truth {path}, feature {number}: expected a LineString with heights ({error})") from error
    return markings


@dataclass(frozen=True)
class MarkingErrors:
    """Found markings compared with the truth, by samples 0.1 m apart: T of the truth, S of what was found.

    Of vertices (V) that belong to a marking: errors across the marking and upwards.
    """

    truth_index: NDArray[np.int64]
    """(T,)"""
    truth_visible: Bools
    """(T,)"""
    truth_found: Bools
    """(T,)"""
    matched: NDArray[np.int64]
    """(S,) marking of the truth, -1 where there is none within the buffer"""
    found: Mapping[str, Floats]
    """Errors of the M samples that match: lateral_m (positive to the left of the truth), height_m, and errors of width_m,
    dash_m, gap_m (these two NaN of solid lines); pattern_right (solid or dashed, with dash and gap to 0.5 m) and colour_right, 1
    or 0."""
    vertex_m: Floats
    """(V, 2)"""
    vertex_axes: Floats
    """(V, 2, 3) unit vectors of these in the map"""
    vertex_kept: Bools
    """Which of all vertices these are."""

    def of_truth(self, index: int) -> MarkingErrors:
        """The samples of one marking of the truth."""
        truth, found = self.truth_index == index, self.matched == index
        of_found = self.matched[self.matched >= 0] == index
        return replace(
            self,
            **{name: getattr(self, name)[truth] for name in ("truth_index", "truth_visible", "truth_found")},
            matched=self.matched[found],
            found={name: column[of_found] for name, column in self.found.items()},
        )


class MarkingFigures(Record):
    """Figures of markings, metres and shares of length; None where nothing of the kind was found."""

    truth_m: NonNegative
    """Length of the markings that were visible"""
    found_m: NonNegative
    completeness: float | None
    correctness: float | None
    redundancy: float | None
    """Share of the right length that is there twice"""
    lateral_median_m: float | None
    lateral_p95_m: float | None
    height_median_m: float | None
    height_p95_m: float | None
    width_median_m: float | None
    dash_median_m: float | None
    gap_median_m: float | None
    pattern_share: float | None
    colour_share: float | None


def visible_to(drive: Drive) -> Callable[[Floats], Bools]:
    """Which points (N, 3) a drive probably saw well: in both images of a pair, 4 to 15 m deep and within 8 m to the side."""

    def seen(points_m: Floats) -> Bools:
        found = np.zeros(len(points_m), dtype=bool)
        for pair in drive.frame_pairs:
            rows = np.flatnonzero(~found)
            for side in ("left", "right"):
                local_SE3_map = np.linalg.inv(map_SE3_camera(pair.pose, drive.rig, side))
                local = points_m[rows] @ local_SE3_map[:3, :3].T + local_SE3_map[:3, 3]
                near = (local[:, 2] >= _DEPTHS_M[0]) & (local[:, 2] <= _DEPTHS_M[1]) & (abs(local[:, 0]) <= _ASIDE_M)
                camera = camera_of(drive.rig, side)
                rows, uv = rows[near], image_points(camera, local[near])
                limits = np.array([camera.width_px, camera.height_px]) - 0.5
                rows = rows[((uv >= -0.5) & (uv <= limits)).all(axis=1)]
            found[rows] = True
        return found

    return seen


def compare_markings(
    truth: Sequence[TruthMarking], found: Sequence[Marking], visible: Callable[[Floats], Bools]
) -> MarkingErrors:
    """Errors of markings of a drive, or of stretches on the map.

    A dashed line is visible between its first and last visible paint. Every found metre counts for correctness, visible or not.
    """
    samples = [resampled(np.array(one.vertices_m), _STEP_M) for one in found]
    lines = [np.array(one.vertices_m) for one in truth]
    index = np.repeat(np.arange(len(found)), [len(one) for one in samples])
    nearest, lateral, height, _ = _nearest(np.concatenate([np.zeros((0, 3)), *samples]), lines)

    truth_samples = [resampled(line, _STEP_M) for line in lines]
    truth_index = np.repeat(np.arange(len(truth)), [len(one) for one in truth_samples])
    points = np.concatenate([np.zeros((0, 3)), *truth_samples])
    truth_visible, truth_found = visible(points), np.zeros(len(points), dtype=bool)
    for k, marking in enumerate(truth):
        own = np.flatnonzero(truth_index == k)
        painted = own[truth_visible[own] & _is_painted(marking, stations(truth_samples[k][:, :2]))]
        truth_visible[own] &= (own >= painted.min(initial=len(points))) & (own <= painted.max(initial=-1))
    for j, one in enumerate(samples):
        distance, station, _ = _distances(one, points)
        at = np.rint(np.clip(station, 0.0, None) / stations(one[:, :2])[-1] * (len(one) - 1)).astype(int)
        truth_found |= (distance <= BUFFER_M) & (nearest[index == j][np.clip(at, 0, len(one) - 1)] == truth_index)

    matched = nearest >= 0
    pairs = [(found[j], truth[k]) for j, k in zip(index[matched].tolist(), nearest[matched].tolist(), strict=True)]

    vertices = np.concatenate([np.zeros((0, 3)), *(np.array(one.vertices_m) for one in found)])
    of, across, up, axes = _nearest(vertices, lines)
    keep = of >= 0
    return MarkingErrors(
        truth_index=truth_index,
        truth_visible=truth_visible,
        truth_found=truth_found,
        matched=nearest,
        found={
            "lateral_m": lateral[matched],
            "height_m": height[matched],
            "width_m": np.array([a.width_m - b.width_m for a, b in pairs], dtype=float),
            "dash_m": np.array([_difference(a.dash_m, b.dash_m) for a, b in pairs], dtype=float),
            "gap_m": np.array([_difference(a.gap_m, b.gap_m) for a, b in pairs], dtype=float),
            "pattern_right": np.array([_same_pattern(a, b) for a, b in pairs], dtype=float),
            "colour_right": np.array([a.colour == b.colour for a, b in pairs], dtype=float),
        },
        vertex_m=np.column_stack([across, up])[keep],
        vertex_axes=axes[keep],
        vertex_kept=keep,
    )


def marking_figures(drives: Sequence[MarkingErrors]) -> MarkingFigures:
    """Figures of one drive or of several together."""
    visible, covered = (np.concatenate([getattr(d, name) for d in drives]) for name in ("truth_visible", "truth_found"))
    matched = np.concatenate([d.matched for d in drives]) >= 0
    columns = {name: np.concatenate([d.found[name] for d in drives]) for name in drives[0].found}
    sizes = ("lateral", "height", "width", "dash", "gap")
    return MarkingFigures.model_validate({
        "truth_m": float(visible.sum()) * _STEP_M, "found_m": len(matched) * _STEP_M,
        "completeness": _mean(covered[visible]), "correctness": _mean(matched),
        "redundancy": max(1.0 - float(covered.sum() / matched.sum()), 0.0) if matched.any() else None,
        **{f"{what}_median_m": _quantile(columns[f"{what}_m"], 0.5) for what in sizes},
        **{f"{what}_p95_m": _quantile(columns[f"{what}_m"], 0.95) for what in sizes[:2]},
        **{f"{what}_share": _mean(columns[f"{what}_right"]) for what in ("pattern", "colour")},
    })  # fmt: skip


def marking_consistency(
    errors: MarkingErrors, own_cov_m2: Floats, common_jacobian: Floats, common_cov: Floats
) -> dict[str, Consistency | None]:
    """NEES of the vertices: across the marking, in height, and of both together; None without vertices.

    Vertices farther than the buffer from every marking are not among them. own_cov_m2 (3A, 3A): of all A vertices in the map,
    without the K errors that the whole drive has in common; common_jacobian (A, 3, K), common_cov (K, K): of these.
    """
    results: dict[str, Consistency | None] = dict.fromkeys(NEES_PARTS)
    if len(errors.vertex_m):
        axes, keep = errors.vertex_axes, errors.vertex_kept
        joint = own_cov_m2.reshape(len(keep), 3, len(keep), 3)[keep][:, :, keep]
        joint = np.einsum("nij,njmk,mlk->niml", axes, joint, axes, optimize=True)
        moved = axes @ common_jacobian[keep]
        for name, part in NEES_PARTS.items():
            error_m = errors.vertex_m[:, part]
            own = joint[:, part, :, part].reshape(error_m.size, -1)
            results[name] = consistency(error_m, own, moved[:, part], common_cov)
    return results


def _distances(line_m: Floats, points_m: Floats) -> tuple[Floats, Floats, Floats]:
    """Distance (N,) of points (N, 3) from a line (K, 3) in plan view, station of the nearest point on it, and offset (left)."""
    station, offset = project(line_m[:, :2], points_m[:, :2])
    length = stations(line_m[:, :2])[-1]
    beyond = station - np.clip(station, 0.0, length)
    return np.hypot(offset, beyond), station - beyond, offset


def _nearest(points_m: Floats, lines: Sequence[Floats]) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
    """Nearest line to each of points (N, 3), -1 if none is in the buffer; the point's offset to its left and height above it, NaN
    without a line; axes (N, 2, 3), unit vectors to the left of the line and up."""
    count = len(points_m)
    nearest = np.full(count, -1)
    best, offset, rise = np.full(count, BUFFER_M), np.full(count, np.nan), np.full(count, np.nan)
    axes = np.zeros((count, 2, 3))
    axes[:, 1, 2] = 1.0
    for k, line in enumerate(lines):
        distance, station, aside = _distances(line, points_m)
        nearer = distance <= best
        along = directions_at(line[:, :2], station[nearer])
        nearest[nearer], best[nearer], offset[nearer] = k, distance[nearer], aside[nearer]
        rise[nearer] = points_m[nearer, 2] - np.interp(station[nearer], stations(line[:, :2]), line[:, 2])
        axes[nearer, 0, :2] = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return nearest, offset, rise, axes


def _is_painted(marking: TruthMarking, station_m: Floats) -> Bools:
    """(N,) whether there is paint at stations along a marking; everywhere if its dashes are unknown."""
    if marking.dash_m is None or marking.gap_m is None or marking.dash_start_m is None:
        return np.ones(len(station_m), dtype=bool)
    return np.asarray((station_m - marking.dash_start_m) % (marking.dash_m + marking.gap_m) < marking.dash_m)


def _same_pattern(found: Marking, truth: TruthMarking) -> bool:
    if found.pattern != truth.pattern:
        return False
    differences = _difference(found.dash_m, truth.dash_m), _difference(found.gap_m, truth.gap_m)
    return truth.pattern == "solid" or max(map(abs, differences)) <= DASH_TOLERANCE_M


def _difference(a: float | None, b: float | None) -> float:
    return np.nan if a is None or b is None else a - b


def _quantile(errors: Floats, share: float) -> float | None:
    """Quantile of the absolute values of the known errors."""
    known = np.abs(errors[~np.isnan(errors)])
    return float(np.quantile(known, share)) if len(known) else None


def _mean(values: Floats | Bools) -> float | None:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else None
