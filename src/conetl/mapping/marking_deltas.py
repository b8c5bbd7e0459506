"""Deltas of stretches of lane markings, and the state of the stretches after them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple
from uuid import UUID, uuid5

import numpy as np

from conetl.geometry.calibration.covariance import pack_jacobians, unpack_jacobians
from conetl.geometry.packing import cov3, cov_matrices, vec3
from conetl.mapping.deltas import add_counts
from conetl.mapping.existence_update import observed
from conetl.mapping.fusion import OffsetErrors, birge_ratios, fuse, in_map_frame
from conetl.mapping.marking_lines import Feet, Lines, lines_of
from conetl.mapping.visibility import MarkingView
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.base import SharedErrorJacobian
from conetl.model.map_records import Delta, DeltaKind, ExistenceEvidence, MapFeature
from conetl.model.markings import Marking, MarkingTrack

_NAMESPACE = UUID("3c0a8d52-1f7e-4f0b-9d35-8e1c6a7b2f49")
#: Greatest length of a stretch on the map, and of the distance of its vertices, which is about that of the drive's vertices.
STRETCH_M, _LONGEST_STEP_M = 10.0, 3.5
#: Vertices of a drive nearer than this to the end of a stretch are left out.
_LEAST_STEP_M = 0.5
#: Thickness of paint, and its sigma: the height of the object.
_PAINT_M, _PAINT_SIGMA_M = 0.003, 0.002
#: Variance of an observed vertex along its line, where it is not observed.
_ALONG_M2 = 1e4
#: A drive that observed a marking in fewer frame pairs does not decide what it looks like.
_LEAST_FRAMES = 5
#: Turns below this leave a Jacobian as it is.
_LEAST_TURN = np.radians(1.0)


class LineDrive(NamedTuple):
    """The lane markings of a drive, their vertices in one array."""

    tracks: Sequence[MarkingTrack]
    lines: Lines
    """In the drive's own frame."""
    cov_m2: Floats
    """(V, 3, 3)"""
    relative_m2: Floats
    """(V, 3, 3)"""
    shift_m: Floats
    """(3,) what is subtracted from its positions on the map."""
    shift_errors: OffsetErrors | None = None
    """None where nothing is subtracted, or no stretch was observed again: the covariances then stay those of the drive."""

    def length_m(self, line: int) -> float:
        return float(self.lines.station_m[self.lines.line == line].max())


class StretchSighting(NamedTuple):
    """How a drive observed a stretch, or a part of one of its own markings."""

    track: int
    """Number of the marking in `LineDrive.tracks`."""
    frames: int
    first_ns: int
    last_ns: int


def line_drive(markings: Sequence[MarkingTrack]) -> LineDrive:
    """The markings in the order of `marking_index`, without any offset subtracted."""
    tracks = sorted(markings, key=lambda track: track.marking_index)
    return LineDrive(
        tracks,
        lines_of([np.array(track.marking.vertices_m) for track in tracks]),
        cov_matrices([cov for track in tracks for cov in track.marking.cov_m2]),
        cov_matrices([cov for track in tracks for cov in track.relative_cov_m2]),
        np.zeros(3),
    )


def lines_on_map(stretches: Sequence[MapFeature]) -> tuple[Lines, Floats]:
    """The lines of features, numbered as these are, and the covariances (V, 3, 3) in m^2 of their vertices."""
    shapes = [shape_of(feature) for feature in stretches]
    lines = lines_of([np.array(shape.vertices_m) for shape in shapes])
    return lines, cov_matrices([cov for shape in shapes for cov in shape.cov_m2])


def shape_of(feature: MapFeature) -> Marking:
    """Raises ValueError for a point object."""
    if feature.marking is None:
        raise ValueError(f"feature {feature.feature_id} is not a line")
    return feature.marking


def sighting(track: int, drive: LineDrive, view: MarkingView, vertices: Bools) -> StretchSighting:
    """How the drive observed vertices (n,) of a stretch: the frame pairs that had any of them in view or, if unknown, those of
    the whole marking."""
    whole, own = drive.tracks[track], view.period_of(vertices)
    if own is None:
        return StretchSighting(track, whole.observation_count, whole.first_seen_ns, whole.last_seen_ns)
    return StretchSighting(track, min(own[0], whole.observation_count), own[1], own[2])


def confirm_stretches(
    sightings: Mapping[int, StretchSighting],
    features: Sequence[MapFeature],
    on_map: Lines,
    found: Feet,
    drive: LineDrive,
    evidence: Mapping[int, ExistenceEvidence],
) -> dict[int, Delta]:
    """Confirm stretches (by number): every observed vertex moves across the line and in height, by the covariances.

    found: the observed vertices, and where on the drive's markings they are. As for cones (`deltas.confirm_features`) the drive's
    markings enter in the drive's own frame.
    """
    number = on_map.line[found.point]
    found = found.only(np.isin(number, list(sightings)))
    if not len(found.point):
        return {}
    number, at = on_map.line[found.point], found.point
    along = np.column_stack([on_map.tangents[at], np.zeros(len(at))])
    across = np.eye(3) - along[:, :, None] * along[:, None, :]
    apart = (across @ (found.at(drive.lines.vertices_m) - on_map.vertices_m[at])[:, :, None])[:, :, 0]
    measured = found.at(drive.cov_m2) + _ALONG_M2 * along[:, :, None] * along[:, None, :]
    old_cov = [cov for feature in features for cov in shape_of(feature).cov_m2]
    gain, cov, jacobians, difference_m2 = fuse(
        [old_cov[k] for k in at.tolist()],
        [features[j].shared_jacobian for j in number.tolist()],
        list(map(cov3, measured)),
        _turned_jacobians(drive, found),
    )
    cov[:, range(3), range(3)] *= birge_ratios(apart, difference_m2)
    vertices_m = on_map.vertices_m.copy()
    vertices_m[at] += (across @ gain @ apart[:, :, None])[:, :, 0]
    new_cov = dict(zip(at.tolist(), map(cov3, cov), strict=True))
    new_jacobian = dict(zip(at.tolist(), jacobians, strict=True))
    deltas = {}
    for j, seen in sightings.items():
        old, shape = features[j], shape_of(features[j])
        rows = np.flatnonzero(on_map.line == j)
        middle = int(rows[len(rows) // 2])
        marking = Marking(
            vertices_m=tuple(map(vec3, vertices_m[rows])),
            cov_m2=tuple(new_cov.get(k, old_cov[k]) for k in rows.tolist()),
            **_attributes(shape, old.observation_count, drive.tracks[seen.track].marking, seen.frames),
        )
        jacobian = new_jacobian.get(middle, old.shared_jacobian)
        own = _feature(old.feature_id, old.version + 1, old.category, marking, jacobian, seen, evidence[j])
        deltas[j] = Delta(
            kind=DeltaKind.CONFIRMED,
            feature_id=old.feature_id,
            old=old,
            new=add_counts(old, own),
            changed_at_ns=seen.first_ns,
            shift_m=float(np.hypot(*(vertices_m[middle] - on_map.vertices_m[middle])[:2])),
            evidence=evidence[j],
        )
    return deltas


def move_stretch(
    feature: MapFeature, found: Feet, seen: StretchSighting, drive: LineDrive, evidence: ExistenceEvidence
) -> Delta:
    """Move a repainted stretch: its vertices become those of the drive's marking beside it."""
    new = _of_drive(found, seen, drive, feature.feature_id, feature.version + 1, evidence)
    return Delta(
        kind=DeltaKind.MOVED,
        feature_id=feature.feature_id,
        old=feature,
        new=add_counts(feature, new),
        changed_at_ns=seen.first_ns,
        shift_m=float(np.abs(found.lateral_m).mean()),
        evidence=evidence,
    )


def new_stretch(
    found: Feet, seen: StretchSighting, drive: LineDrive, founding_key: str, evidence: ExistenceEvidence
) -> Delta:
    """A new stretch. Its id follows from the marking of the drive and the station (dm) at which it begins."""
    begins_dm = round(10 * float(found.station_m[0]))
    feature_id = uuid5(_NAMESPACE, f"{founding_key}/{drive.tracks[seen.track].marking_index}/{begins_dm}")
    return Delta(
        kind=DeltaKind.ADDED,
        feature_id=feature_id,
        new=_of_drive(found, seen, drive, feature_id, 1, evidence),
        changed_at_ns=seen.first_ns,
        evidence=evidence,
    )


def split_stretch(confirmation: Delta, vertices: Ints, at_ns: int, founding_key: str) -> Delta:
    """The remaining part of a removed stretch: successive vertices of its confirmed state, as a new stretch."""
    whole = confirmation.state_after
    shape = shape_of(whole)
    feature_id = uuid5(_NAMESPACE, f"{founding_key}/{whole.feature_id}/{int(vertices[0])}")
    part = {
        "vertices_m": tuple(shape.vertices_m[k] for k in vertices.tolist()),
        "cov_m2": tuple(shape.cov_m2[k] for k in vertices.tolist()),
    }
    middle = int(vertices[len(vertices) // 2])
    own = {"feature_id": feature_id, "version": 1, "seen_count": 1, "missed_count": 0}
    at = {"xyz_m": shape.vertices_m[middle], "centre_xyz_m": shape.vertices_m[middle], "cov_m2": shape.cov_m2[middle]}
    new = whole.model_copy(update=own | at | {"marking": shape.model_copy(update=part)})
    return Delta(
        kind=DeltaKind.SPLIT,
        feature_id=feature_id,
        new=new,
        changed_at_ns=at_ns,
        other_feature_id=whole.feature_id,
        evidence=confirmation.evidence,
    )


def stretches_of(drive: LineDrive, line: int, part_m: tuple[float, float]) -> list[Feet]:
    """A part of a drive's marking, from one station to another, cut into stretches of at most `STRETCH_M` at its vertices."""
    rows = np.flatnonzero(drive.lines.line == line)
    station_m = drive.lines.station_m[rows]
    begin_m, end_m = part_m
    inner = station_m[(station_m > begin_m + _LEAST_STEP_M) & (station_m < end_m - _LEAST_STEP_M)]
    at_m = np.concatenate([[begin_m], inner, [end_m]])
    steps = [np.linspace(a, b, int(np.ceil((b - a) / _LONGEST_STEP_M)), endpoint=False) for a, b in pairwise(at_m)]
    at_m = np.concatenate([*steps, [end_m]])
    cuts = [0]
    while cuts[-1] < len(at_m) - 1:
        reached = int(np.searchsorted(at_m, at_m[cuts[-1]] + STRETCH_M + 1e-6, side="right")) - 1
        cuts.append(max(reached, cuts[-1] + 1))
    if len(cuts) > 2 and cuts[-1] - cuts[-2] < 2 <= cuts[-2] - cuts[-3] - 1:  # no stretch of one step only
        cuts[-2] -= 1
    pieces = []
    for first, last in pairwise(cuts):
        own_m = at_m[first : last + 1]
        segment = np.clip(np.searchsorted(station_m, own_m, side="right") - 1, 0, len(rows) - 2)
        share = (own_m - station_m[segment]) / (station_m[segment + 1] - station_m[segment])
        lines = np.full(len(own_m), line)
        pieces.append(
            Feet(np.arange(len(own_m)), lines, rows[segment], np.clip(share, 0, 1), own_m, np.zeros(len(own_m)))
        )
    return pieces


def _of_drive(
    found: Feet, seen: StretchSighting, drive: LineDrive, feature_id: UUID, version: int, evidence: ExistenceEvidence
) -> MapFeature:
    """Points of a drive's marking as a stretch."""
    track = drive.tracks[seen.track]
    cov, jacobians = list(map(cov3, found.at(drive.cov_m2))), _turned_jacobians(drive, found)
    if drive.shift_errors is not None:
        relative = list(map(cov3, found.at(drive.relative_m2)))
        cov, jacobians = in_map_frame(cov, relative, jacobians, drive.shift_errors)
    vertices_m = tuple(map(vec3, found.at(drive.lines.vertices_m) - drive.shift_m))
    marking = track.marking.model_copy(update={"vertices_m": vertices_m, "cov_m2": tuple(cov)})
    return _feature(feature_id, version, track.category, marking, jacobians[len(cov) // 2], seen, evidence)


def _feature(
    feature_id: UUID,
    version: int,
    category: str,
    marking: Marking,
    shared_jacobian: SharedErrorJacobian | None,
    seen: StretchSighting,
    evidence: ExistenceEvidence,
) -> MapFeature:
    """A stretch as one drive observed it."""
    middle = len(marking.vertices_m) // 2
    return MapFeature(
        feature_id=feature_id,
        version=version,
        category=category,
        xyz_m=marking.vertices_m[middle],
        cov_m2=marking.cov_m2[middle],
        centre_xyz_m=marking.vertices_m[middle],
        object_height_m=_PAINT_M,
        object_height_sigma_m=_PAINT_SIGMA_M,
        **observed(None, evidence),
        observation_count=seen.frames,
        first_seen_ns=seen.first_ns,
        last_seen_ns=seen.last_ns,
        shared_jacobian=shared_jacobian,
        marking=marking,
    )


def _attributes(old: Marking, old_frames: int, new: Marking, new_frames: int) -> dict[str, object]:
    """Width by its sigmas, lengths of dashes by frame pairs; colour and pattern from the newest drive."""
    weights = old.width_sigma_m**-2, new.width_sigma_m**-2
    fused: dict[str, object] = {
        "width_m": (weights[0] * old.width_m + weights[1] * new.width_m) / sum(weights),
        "width_sigma_m": sum(weights) ** -0.5,
    }
    sure = new_frames >= _LEAST_FRAMES
    fused["colour"] = new.colour if sure and new.colour != "other" else old.colour
    pattern = new if sure else old
    fused |= {name: getattr(pattern, name) for name in ("pattern", "dash_m", "gap_m")}
    if old.dash_m and old.gap_m and new.dash_m and new.gap_m:
        share = new_frames / (old_frames + new_frames)
        fused["dash_m"] = (1 - share) * old.dash_m + share * new.dash_m
        fused["gap_m"] = (1 - share) * old.gap_m + share * new.gap_m
    return fused


def _turned_jacobians(drive: LineDrive, found: Feet) -> list[SharedErrorJacobian | None]:
    """Jacobians at the points of `found` (K,): those of their markings, turned from the middle vertex to the point."""
    heading = np.arctan2(drive.lines.tangents[:, 1], drive.lines.tangents[:, 0])
    first = np.searchsorted(drive.lines.line, np.arange(len(drive.tracks)))
    middle = first + np.array([len(track.relative_cov_m2) // 2 for track in drive.tracks], np.int64)
    turns = heading[found.segment] - heading[middle[found.line]]
    turned: dict[tuple[int, float], SharedErrorJacobian | None] = {}
    result = []
    for line, turn in zip(found.line.tolist(), turns.tolist(), strict=True):
        own = drive.tracks[line].shared_jacobian
        if own is not None and abs((turn + np.pi) % (2 * np.pi) - np.pi) > _LEAST_TURN:
            if (line, turn) not in turned:
                c, s = float(np.cos(turn)), float(np.sin(turn))
                around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
                [turned[line, turn]] = pack_jacobians(
                    own.calibrations, around @ unpack_jacobians(own.calibrations, [own])
                )
            own = turned[line, turn]
        result.append(own)
    return result
