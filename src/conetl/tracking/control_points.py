"""Surveyed control points in the adjustment of a drive's poses: detected cones with known coordinates.

Points and cones belong together by position; names do not matter. Which points agree is decided by the joint covariance of the
cones before any is used: one that the others contradict is reported and left out (data snooping, Baarda 1968). If three agree
that GNSS/INS is wrong by more than it states, they are used; fewer are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from conetl.geometry.consistency import leave_one_out_nees, point_nees
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.packing import cov_matrices, vec3
from conetl.model.arrays import Bools, Floats
from conetl.model.check_params import ControlCheckParams
from conetl.model.drive import FramePair, Position, StereoMatch, SurveyedPoint
from conetl.model.health import Finding
from conetl.model.params import IngestParams
from conetl.model.rig import Rig
from conetl.tracking.drive_refinement import cone_groups, refine_with_cones
from conetl.tracking.error_propagation import moved_by_poses, moved_cov, outline_errors, pose_cov
from conetl.tracking.trajectory import ControlCone, RefinedTrajectory, RefinementOutcome

NAME = "control points"
#: At most about this many points are tried as the one from which the others are predicted.
_MOST_SEEDS = 12
#: Points farther than this from all poses (m) have no cone in view.
_FAR_M = 100.0
#: Of observations nearer to each other than this (m) that were not joined, the larger group is the cone.
_SAME_M = 0.75


@dataclass(frozen=True)
class _Cones:
    """G cones near the points, as a trajectory locates them."""

    groups: list[tuple[Position, ...]]
    xyz_m: Floats
    """(G, 3)"""
    joint_cov: Floats
    """(G, 3, G, 3) with the errors of the poses."""
    outline_cov: Floats
    """(G, 3, 3) of what all positions of a cone err in common."""


#: GNSS/INS where it may be wrong by more than it states: (3,) m, the median sigmas of its positions, and by how much these
#: change against those that the images show.
_Log = tuple[Floats, Floats]


@dataclass(frozen=True)
class _Tie:
    """Which points stand on which cones."""

    cones: _Cones
    cone_of: dict[int, int]
    """By point, of those that agree with each other."""
    wrong: dict[int, float]
    """By point: m from the cone that is there, where the others contradict it."""
    ambiguous: bool = False


def refine_with_control(
    frame_pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    matches: Sequence[StereoMatch],
    params: IngestParams,
    points: Sequence[SurveyedPoint],
) -> RefinedTrajectory:
    """As `refine_with_cones`, adjusted to those control points that agree; `control` of the result lists those that do not."""
    plain = refine_with_cones(frame_pairs, rig, motions, matches, params)
    if not points or not params.trajectory.refine:
        return plain
    limits = params.check.control
    path = np.array([pair.pose.map_t_body_m[:2] for pair in frame_pairs])
    low, high = path.min(axis=0) - _FAR_M, path.max(axis=0) + _FAR_M
    count = len(points)
    points = [point for point in points if ((low <= point.xyz_m[:2]) & (point.xyz_m[:2] <= high)).all()]
    if not points:
        return replace(plain, control=_none_near(count))

    def adjusted(pairs: Sequence[FramePair], before: RefinedTrajectory, log: _Log | None = None) -> RefinedTrajectory:
        tie = _tied(before, rig, matches, params, points)
        check = _check(points, tie, log, limits)
        if not check.value:
            return replace(plain, control=check)
        control = [
            ControlCone(
                tie.cones.groups[g],
                np.array(points[i].xyz_m),
                np.diag(np.square(points[i].sigma_m)) + tie.cones.outline_cov[g],
            )
            for i, g in tie.cone_of.items()
        ]
        refined = refine_with_cones(pairs, rig, motions, matches, params, control)
        if refined.outcome is RefinementOutcome.REFINED:
            return replace(refined, control=check)
        return replace(
            plain,
            control=_unused("not adjusted", why=refined.detail),
        )

    found = adjusted(frame_pairs, plain)
    if found.control is not None and found.control.found:
        loose = [
            pair.with_pose(sigma_enu_m=vec3(np.hypot(pair.pose.sigma_enu_m, limits.free_m))) for pair in frame_pairs
        ]
        stated_m = np.median([pair.pose.sigma_enu_m for pair in frame_pairs], axis=0)
        freely = refine_with_cones(loose, rig, motions, matches, params)
        adjusted_m, logged_m = (
            np.array([pair.pose.map_t_body_m for pair in pairs]) for pairs in (freely.frame_pairs, freely.logged)
        )
        free = adjusted(loose, freely, (stated_m, np.ptp(adjusted_m - logged_m, axis=0)))
        if free.control is not None and (free.control.value or 0) > (found.control.value or 0):
            return free
    return found


def _tied(
    trajectory: RefinedTrajectory,
    rig: Rig,
    matches: Sequence[StereoMatch],
    params: IngestParams,
    points: Sequence[SurveyedPoint],
) -> _Tie:
    """The largest set of points that agree about the cones of a trajectory."""
    xyz_m = np.array([point.xyz_m for point in points])
    limits = params.check.control
    reach_m = limits.near_m + 3 * max(max(pair.pose.sigma_enu_m[:2]) for pair in trajectory.logged)
    cones = _located(trajectory, cone_groups(trajectory, rig, matches, params), rig, params, xyz_m, reach_m)
    if not cones.groups:
        return _Tie(cones, {}, {})
    survey = np.square([point.sigma_m for point in points])[:, :, None] * np.eye(3)
    off = xyz_m[:, None] - cones.xyz_m
    near = np.linalg.norm(off[:, :, :2], axis=2) <= reach_m
    alone = _chi2(cones, survey, off, near, {})
    first = np.flatnonzero((alone <= limits.gate_chi2).any(axis=1))
    found: list[tuple[int, float, dict[int, int]]] = []
    # One of the points from which the others are predicted has to be right.
    for i in first[:: len(first) // _MOST_SEEDS + 1].tolist():
        for g in np.flatnonzero(alone[i] <= limits.gate_chi2).tolist():
            chosen, total = {i: g}, float(alone[i, g])
            chi2 = _chi2(cones, survey, off, near, chosen)
            best_first = np.argsort(chi2, axis=None)[: np.count_nonzero(chi2 <= limits.gate_chi2)]
            for k, h in np.column_stack(np.unravel_index(best_first, chi2.shape)).tolist():
                if k not in chosen and h not in chosen.values():
                    chosen[k] = h
                    total += float(chi2[k, h])
            found.append((-len(chosen), total, chosen))
    found.sort(key=lambda item: item[:2])
    chosen = found[0][2] if found else {}
    ambiguous = any(
        size == found[0][0] and total < found[0][1] + limits.ambiguous_chi2 and other != chosen
        for size, total, other in found[1:]
    )
    chosen = _without_contradictions(cones, survey, off, dict(chosen), limits.gate_chi2)
    apart = np.linalg.norm(off - _expected(cones, survey, off, chosen)[0], axis=2)
    apart[:, list(chosen.values())] = np.inf
    nearest_m = np.where(near, apart, np.inf).min(axis=1).tolist()
    wrong = {k: away_m for k, away_m in enumerate(nearest_m) if k not in chosen and away_m <= limits.near_m}
    return _Tie(cones, chosen, wrong, ambiguous)


def _located(
    trajectory: RefinedTrajectory,
    groups: Sequence[tuple[Position, ...]],
    rig: Rig,
    params: IngestParams,
    xyz_m: Floats,
    reach_m: float,
) -> _Cones:
    """The cones within reach of a point (N, 3), with their joint covariance.

    Each has the pose error of its nearest observation.
    """
    rank = {pair.frame_index: k for k, pair in enumerate(trajectory.frame_pairs)}
    kept: list[tuple[Position, ...]] = []
    places: list[Floats] = []
    own, outlines, states = [], [], []
    for group in sorted(groups, key=len, reverse=True):
        left = trajectory.map_SE3_left[[rank[p.frame_index] for p in group]]
        turn = left[:, :3, :3]
        seen = np.einsum("fij,fj->fi", turn, [p.camera_xyz_m for p in group]) + left[:, :3, 3]
        weights = np.linalg.inv(turn @ cov_matrices([p.camera_cov_m2 for p in group]) @ np.swapaxes(turn, 1, 2))
        cov = np.linalg.inv(weights.sum(axis=0))
        place = cov @ (weights @ seen[:, :, None]).sum(axis=0)[:, 0]
        if np.linalg.norm(xyz_m[:, :2] - place[:2], axis=1).min() > reach_m:
            continue
        if any(np.linalg.norm(place[:2] - other[:2]) < _SAME_M for other in places):
            continue
        nearest = int(np.argmin([p.range_m for p in group]))
        outline = turn[nearest] @ outline_errors(group[nearest], rig)
        of_scale = (params.trajectory.scale_sigma * group[nearest].range_m) ** 2 * np.eye(3)
        kept.append(group)
        places.append(place)
        outlines.append(outline @ outline.T + of_scale)
        own.append(cov + outlines[-1])
        states.append(group[nearest].frame_index)
    frames = sorted(set(states))
    feet = np.array(places).reshape(-1, 3)
    joint = np.zeros((len(kept), 3, len(kept), 3))
    if kept:
        jacobian = moved_by_poses(feet, [trajectory.frame_pairs[rank[index]].pose for index in states])
        of_poses = pose_cov(trajectory, params.trajectory)(frames)
        joint += moved_cov(jacobian, np.searchsorted(frames, states), of_poses).reshape(joint.shape)
        joint[np.arange(len(kept)), :, np.arange(len(kept))] += np.array(own)
    return _Cones(kept, feet, joint, np.array(outlines).reshape(-1, 3, 3))


def _expected(cones: _Cones, survey: Floats, off: Floats, chosen: dict[int, int]) -> tuple[Floats, Floats]:
    """What each point is expected to be off each cone, given those that are chosen: (G, 3) and its covariance (G, 3, 3).

    survey (N, 3, 3): covariance of the points, which is not in the result; off (N, G, 3): points minus cones.
    """
    count = len(cones.groups)
    alone = cones.joint_cov[np.arange(count), :, np.arange(count)]
    if not chosen:
        return np.zeros((count, 3)), alone
    at, size = list(chosen.values()), 3 * len(chosen)
    known = _off_cov(cones, survey, chosen)
    with_known = cones.joint_cov[:, :, at].reshape(3 * count, size)
    gain = np.linalg.solve(known.reshape(size, size), with_known.T).T
    mean = gain @ np.concatenate([off[i, g] for i, g in chosen.items()])
    less = np.einsum("gik,gjk->gij", gain.reshape(count, 3, size), with_known.reshape(count, 3, size))
    return mean.reshape(count, 3), alone - less


def _off_cov(cones: _Cones, survey: Floats, chosen: dict[int, int]) -> Floats:
    """(C, 3, C, 3) covariance of the differences of the C chosen points and their cones."""
    at, each = list(chosen.values()), np.arange(len(chosen))
    cov = cones.joint_cov[at][:, :, at].copy()
    cov[each, :, each] += survey[list(chosen)]
    return cov


def _chi2(cones: _Cones, survey: Floats, off: Floats, near: Bools, chosen: dict[int, int]) -> Floats:
    """(N, G) of each point on each cone near it, given those that are chosen; infinite for others."""
    mean, cov = _expected(cones, survey, off, chosen)
    points, at = np.nonzero(near)
    found = np.full(near.shape, np.inf)
    found[points, at] = point_nees(off[points, at] - mean[at], cov[at] + survey[points])
    return found


def _without_contradictions(
    cones: _Cones, survey: Floats, off: Floats, chosen: dict[int, int], gate_chi2: float
) -> dict[int, int]:
    """The points that all others confirm: the one that fits worst is left out until all do."""
    while len(chosen) > 1:
        size, off_chosen = 3 * len(chosen), np.array([off[i, g] for i, g in chosen.items()])
        misfits = leave_one_out_nees(off_chosen, _off_cov(cones, survey, chosen).reshape(size, size))
        worst = int(misfits.argmax())
        if misfits[worst] <= gate_chi2:
            break
        del chosen[list(chosen)[worst]]
    return chosen


def _check(points: Sequence[SurveyedPoint], tie: _Tie, log: _Log | None, limits: ControlCheckParams) -> Finding:
    """What was found about the points; its value is how many are used. log: if it may be wrong by more than it states."""
    used, wrong, count = len(tie.cone_of), len(tie.wrong), len(points)
    named = ", ".join(f"{points[k].name} ({metres:.2f} m from the cone there)" for k, metres in tie.wrong.items())
    if not used and not wrong:
        return _none_near(count)
    if (wrong and (used < 2 or used <= wrong)) or (log is not None and used < limits.least_agreeing):
        agreeing = ", ".join(points[k].name for k in tie.cone_of)
        says = ("contradict", *(["only"] if used else []), "survey")
        return _unused(*says, named=named, agreeing=agreeing, least=limits.least_agreeing)
    if tie.ambiguous:
        twins = [
            f"{one.name} and {other.name}"
            for one, other in combinations(points, 2)
            if np.linalg.norm(np.subtract(one.xyz_m, other.xyz_m)) < _SAME_M
        ]
        return _unused("twins" if twins else "ambiguous", count=count, twins=", ".join(twins))
    finding = Finding(
        check=NAME, value=float(used), found=wrong > 0, says=("used",), facts={"used": used, "count": count}
    )
    if log is not None:
        finding = _with_log(finding, points, tie, log, limits)
    return finding.saying(*finding.says, "wrong", named=named) if wrong else finding


def _with_log(
    finding: Finding, points: Sequence[SurveyedPoint], tie: _Tie, log: _Log, limits: ControlCheckParams
) -> Finding:
    """The finding with how the log differs from the points that are used: in height only, all along the drive, or by a drift."""
    stated_m, drift_m = log
    mean_m = np.mean([points[i].xyz_m - tie.cones.xyz_m[g] for i, g in tie.cone_of.items()], axis=0)
    both_m = np.hypot(stated_m, np.mean([points[i].sigma_m for i in tie.cone_of], axis=0))
    off = {"off_m": float(np.linalg.norm(mean_m)), "sigmas": float(np.abs(mean_m / both_m).max())}
    if np.hypot(*mean_m[:2]) < limits.same_plan_m:
        return finding.model_copy(update={"found": True}).saying("used", "in height", **off)
    if (drift_m < limits.drift_sigmas * both_m).all():
        return finding.model_copy(update={"found": True}).saying("used", "all along", **off)
    return finding.model_copy(update={"treated": "corrected"}).saying("used", "drift", **off)


def _unused(*says: str, **facts: int | str) -> Finding:
    return Finding(check=NAME, value=0.0, found=True, says=says, facts=facts)


def _none_near(count: int) -> Finding:
    return _unused("none near", count=count)
