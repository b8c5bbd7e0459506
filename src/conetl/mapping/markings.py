"""Lane markings of one drive against those of the map -> deltas; docs/explanation/changes.md has the rules.

A lane marking on the map is a row of stretches of at most 10 m, each a feature. The drive's offset is subtracted, then a marking
of the drive is searched for across each vertex of a stretch (`marking_lines.py`). A vertex is missed if the drive had it in view
and no marking is there. A stretch is confirmed by two observed vertices unless half of its vertices are missed. A missed stretch
with a free marking beside it was repainted (moved); one whose existence probability becomes low enough is removed, and its
observed parts become new stretches (split). Parts of the drive's markings that no stretch claims are added.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.mapping import marking_deltas
from conetl.mapping.deltas import ReconcileContext, miss_or_remove
from conetl.mapping.existence_update import confirmation_evidence, is_gone, miss_evidence
from conetl.mapping.fusion import offset_errors
from conetl.mapping.marking_lines import Claims, Feet, Lines, feet, lateral_offset
from conetl.mapping.visibility import MarkingView, NotObserved, ViewCheck
from conetl.model.arrays import Bools, Floats
from conetl.model.map_records import Delta, ExistenceEvidence, MapFeature
from conetl.model.markings import MarkingTrack, marking_existence
from conetl.model.params import ReconcileParams

#: Offset to which another colour or width is equivalent in matching, and the difference that makes another width.
_UNLIKE_M, _OTHER_WIDTH_M = 0.1, 0.06
#: Sigmas of the distance at which two markings may still be the same one.
_GATE_SIGMAS = 4.0
#: Minimum number of vertices by which a stretch is observed, or gone.
_LEAST_VERTICES = 2
#: A drive that shows less than this share of the length that it misses may have been unable to see markings.
_LEAST_SHOWN, _SPACING_M = 0.5, 2.5


class _State(NamedTuple):
    """What a drive shows of the vertices (n,) of a stretch."""

    seen: Bools
    missed: Bools
    view: MarkingView
    """Of the vertices, since the stretch was last observed."""

    @property
    def half_is_gone(self) -> bool:
        count = int(self.missed.sum())
        return count >= _LEAST_VERTICES and 2 * count >= len(self.missed)


@dataclass(frozen=True)
class _Comparison:
    """The lines of a drive and of the map, and which of them are the same."""

    drive: marking_deltas.LineDrive
    features: Sequence[MapFeature]
    on_map: Lines
    found: Feet
    """All feet from the map's vertices to lines of the drive beside them."""
    near: Bools
    """(K,) of `found`: whether it may be the same marking."""
    penalty_m: Floats
    """(K,) of `found`."""
    claims: Claims
    same: Feet
    """Those of `found` that are the same marking."""


def reconcile_markings(
    markings: Sequence[MarkingTrack],
    stretches: Sequence[MapFeature],
    check_view: ViewCheck,
    context: ReconcileContext,
    *,
    offset: tuple[Floats, float],
) -> list[Delta]:
    """Deltas of the lane markings from the map before the drive to the map after it; no order matters.

    offset: of the drive's cones (`association.common_offset`); if its weight is 0, that of the lines is used.
    """
    params, founding_key, pinned, _ = context
    c = _compare(markings, stretches, params, offset)
    drive, features = c.drive, c.features
    states = _stretch_states(c, check_view, params)

    def evidence_for(j: int, one: marking_deltas.StretchSighting) -> ExistenceEvidence:
        # An observation is never evidence against the marking.
        return confirmation_evidence(features[j], max(_own_existence(drive, one), 0.5), one.frames)

    seen = {
        j: marking_deltas.sighting(_main_line(c, j), drive, one.view, one.seen)
        for j, one in states.items()
        if one.seen.sum() >= _LEAST_VERTICES
    }
    confirmations = marking_deltas.confirm_stretches(
        seen, features, c.on_map, c.same, drive, {j: evidence_for(j, seen[j]) for j in seen}
    )
    fixed = {j for j, feature in enumerate(features) if feature.feature_id in pinned}
    absent = {j: one for j, one in states.items() if one.half_is_gone and not (j in seen and j in fixed)}
    deltas = [delta for j, delta in confirmations.items() if j not in absent]
    against = _absence_evidence(absent, c, params)

    sure = np.array([t.existence_probability >= params.founding_existence_probability for t in drive.tracks], bool)
    vanished = {j for j, (_, one) in against.items() if is_gone(one, params, moved=True)} - fixed - seen.keys()
    anew = _find_repainted(c, states, vanished, sure)
    for j, own in anew.items():
        where = np.isin(np.flatnonzero(c.on_map.line == j), own.point)
        one = marking_deltas.sighting(int(own.line[0]), drive, states[j].view, where)
        deltas.append(marking_deltas.move_stretch(features[j], own, one, drive, evidence_for(j, one)))
    for j in against.keys() - anew.keys():
        absence, evidence = against[j]
        gone = j not in fixed and is_gone(evidence, params)
        end = miss_or_remove(features[j], absence.first_ns, evidence, gone=gone)
        deltas.append(end)
        if gone and j in seen:
            rest = _runs(states[j].seen)
            deltas += [
                marking_deltas.split_stretch(confirmations[j], run, end.changed_at_ns, founding_key) for run in rest
            ]
    for i in np.flatnonzero(sure).tolist():
        for part_m in c.claims.free_parts(i, drive.length_m(i), params.marking_least_m):
            for piece in marking_deltas.stretches_of(drive, i, part_m):
                view = check_view(piece.at(drive.lines.vertices_m))
                one = marking_deltas.sighting(i, drive, view, np.ones(len(piece.point), bool))
                founding = confirmation_evidence(None, _own_existence(drive, one), one.frames)
                if founding.existence_probability >= params.founding_existence_probability:
                    deltas.append(marking_deltas.new_stretch(piece, one, drive, founding_key, founding))
    return deltas


def _own_existence(drive: marking_deltas.LineDrive, one: marking_deltas.StretchSighting) -> float:
    """Existence probability of a part of a marking: that of the whole, or less if it was in fewer frame pairs."""
    whole = drive.tracks[one.track]
    return min(whole.existence_probability, marking_existence(one.frames, whole.contrast))


def _compare(
    markings: Sequence[MarkingTrack],
    stretches: Sequence[MapFeature],
    params: ReconcileParams,
    offset: tuple[Floats, float],
) -> _Comparison:
    drive, features = marking_deltas.line_drive(markings), sorted(stretches, key=lambda feature: feature.feature_id)
    on_map, map_cov = marking_deltas.lines_on_map(features)
    offset_m, weight = offset
    if weight == 0:
        offset_m, weight = lateral_offset(drive.lines, on_map, _variance(drive.cov_m2), _variance(map_cov), params)
    placed = drive.lines._replace(vertices_m=drive.lines.vertices_m - offset_m)
    found = feet(on_map, placed, params.marking_moved_max_m)
    apart_m = (found.at(placed.vertices_m) - on_map.vertices_m[found.point])[:, 2]
    # With a known offset only the errors that the drive does not share count; otherwise all do.
    cov = found.at(drive.relative_m2) if weight > 0 else found.at(drive.cov_m2) + map_cov[found.point]
    normal = on_map.normals[found.point]
    sigma_m = np.sqrt(np.einsum("ki,kij,kj->k", normal, cov[:, :2, :2], normal))
    near = np.abs(found.lateral_m) <= np.maximum(_GATE_SIGMAS * sigma_m, params.marking_gate_m)
    near &= np.abs(apart_m) <= params.max_rise_m
    penalty_m = _penalty_m(found, on_map, features, drive)
    claims = Claims(found, on_map.line)
    same = found.only(claims.claim(np.flatnonzero(near), penalty_m[near], lambda _: 1))
    errors = None
    if weight > 0 and len(same.point):
        pairs = sorted({*zip(on_map.line[same.point].tolist(), same.line.tolist(), strict=True)})
        jacobians = [drive.tracks[i].shared_jacobian for _, i in pairs]
        errors = offset_errors([features[j] for j, _ in pairs], jacobians, weight)
    drive = drive._replace(shift_m=weight * offset_m, shift_errors=errors)
    return _Comparison(drive, features, on_map, found, near, penalty_m, claims, same)


def _penalty_m(found: Feet, on_map: Lines, features: Sequence[MapFeature], drive: marking_deltas.LineDrive) -> Floats:
    """(K,) penalties for markings of another colour or width."""
    penalty = np.zeros(len(found.point))
    for k, (j, i) in enumerate(zip(on_map.line[found.point].tolist(), found.line.tolist(), strict=True)):
        a, b = marking_deltas.shape_of(features[j]), drive.tracks[i].marking
        other_colour = len({a.colour, b.colour} - {"other"}) == 2
        other_width = abs(a.width_m - b.width_m) > _OTHER_WIDTH_M
        penalty[k] = _UNLIKE_M * (int(other_colour) + int(other_width))
    return penalty


def _stretch_states(c: _Comparison, check_view: ViewCheck, params: ReconcileParams) -> dict[int, _State]:
    """States by number, for stretches of which the drive observed a vertex or had enough in view to miss one."""
    states = {}
    observed = np.zeros(len(c.on_map.line), bool)
    observed[c.same.point] = True
    for j, feature in enumerate(c.features):
        own = c.on_map.line == j
        seen = observed[own]
        view = check_view(c.on_map.vertices_m[own] + c.drive.shift_m).after(feature.last_seen_ns)
        gone = ~seen & (view.in_view.sum(axis=1) >= params.marking_min_frames)
        if seen.any() or gone.any():
            states[j] = _State(seen, gone, view)
    return states


def _main_line(c: _Comparison, j: int) -> int:
    """The drive's marking that matches most vertices of a stretch."""
    return int(np.bincount(c.same.line[c.on_map.line[c.same.point] == j]).argmax())


def _absence_evidence(
    absent: Mapping[int, _State], c: _Comparison, params: ReconcileParams
) -> dict[int, tuple[NotObserved, ExistenceEvidence]]:
    """Evidence against the half-gone stretches."""
    shown_m = sum(c.drive.length_m(i) for i in range(len(c.drive.tracks)))
    is_blind = shown_m < _LEAST_SHOWN * _SPACING_M * sum(int(state.missed.sum()) for state in absent.values())
    ratio = log(params.marking_blind_probability if is_blind else params.marking_missed_probability)
    against = {}
    for j, state in absent.items():
        period = state.view.period_of(state.missed)
        if period is not None:
            absence = NotObserved(frames=period[0], first_ns=period[1], log_likelihood_ratio=ratio)
            against[j] = absence, miss_evidence(c.features[j], absence, params)
    return against


def _find_repainted(
    c: _Comparison, states: Mapping[int, _State], vanished: Collection[int], sure: Bools
) -> dict[int, Feet]:
    """Vanished stretches with a free marking of the drive beside more than half of their vertices."""
    beside = np.flatnonzero(~c.near & np.isin(c.on_map.line[c.found.point], list(vanished)) & sure[c.found.line])
    rows = c.claims.claim(beside, c.penalty_m[beside], lambda j: max(_LEAST_VERTICES, len(states[j].seen) // 2 + 1))
    found = c.found.only(rows)
    stretch = c.on_map.line[found.point]
    return {j: found.only(stretch == j) for j in np.unique(stretch).tolist()}


def _variance(cov_m2: Floats) -> float:
    """Mean horizontal variance of (N, 3, 3) covariances."""
    return float(np.mean(cov_m2[:, 0, 0] + cov_m2[:, 1, 1])) / 2 if len(cov_m2) else 0.0


def _runs(seen: Bools) -> list[NDArray[np.int64]]:
    """Successive observed vertices, at least two each."""
    rows = np.flatnonzero(seen)
    return [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(run) >= _LEAST_VERTICES]
