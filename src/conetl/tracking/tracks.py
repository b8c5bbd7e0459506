"""Positions of one drive -> tracks: one joint adjustment per physical cone, and the belief that it is a cone at all."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.calibration.shared import jacobian_of
from conetl.geometry.joint_fit import JointFit, fit_point
from conetl.geometry.packing import cov3, vec3
from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.model.params import IngestParams, TrackParams
from conetl.model.records import (
    Detection,
    FramePair,
    Position,
    Rig,
    Side,
    StereoMatch,
    Track,
)
from conetl.model.rejections import Rejection, RejectionReason
from conetl.tracking.association import MotionError, chain_positions
from conetl.tracking.common_errors import common_cov, moved_by_calibration, outline_cov
from conetl.tracking.existence import existence_probability

Floats = NDArray[np.float64]
#: Frame, side and number of a detection.
BoxKey = tuple[int, Side, int]


def fuse_tracks(
    positions: Sequence[Position],
    matches: Mapping[tuple[int, int], StereoMatch],
    detections: Mapping[int, Sequence[Detection]],
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    params: IngestParams,
    evidence: DetectorEvidence = UNMEASURED,
    motion: MotionError | None = None,
) -> tuple[list[Track], list[Rejection]]:
    """Fuse the positions of one drive into tracks.

    matches: by (frame_index, match_index). detections: those of both images by frame index. map_SE3_left, map_SE3_right:
    (4, 4) camera -> map by frame index. evidence: what the detector's boxes mean. motion: error of the relative
    motion of a refined trajectory; without it the shares in `params.track` hold. A group that is too short, never near, off the
    road surface, of impossible height or unlikely to be a cone is rejected with the reason.
    """
    tracks: list[Track] = []
    rejections: list[Rejection] = []
    groups = chain_positions(positions, map_SE3_left, params.track, motion)
    in_use = boxes_in_use(groups, matches, params.track)
    for group in sorted(groups, key=lambda g: (g[0].frame_index, g[0].match_index)):
        result = fuse_group(
            len(tracks),
            group,
            matches,
            detections,
            frame_pairs,
            rig,
            map_SE3_left,
            map_SE3_right,
            params,
            evidence,
            motion,
            in_use,
        )
        if isinstance(result, Track):
            tracks.append(result)
        else:
            rejections.append(result)
    return _check_ground(tracks, rejections, map_SE3_left, params.track)


def fuse_group(
    index: int,
    group: tuple[Position, ...],
    matches: Mapping[tuple[int, int], StereoMatch],
    detections: Mapping[int, Sequence[Detection]],
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    params: IngestParams,
    evidence: DetectorEvidence,
    motion: MotionError | None,
    in_use: Collection[BoxKey],
) -> Track | Rejection:
    """The track of one group of positions, or why it is none; arguments as of `fuse_tracks`.

    in_use: boxes of other groups; those of this one may be among them.
    """
    limits = params.track
    if len(group) < limits.min_observations:
        wanted = f"expected at least {limits.min_observations}; one or two boxes may be anything"
        return _reject(RejectionReason.TOO_FEW_OBSERVATIONS, group, f"{len(group)} positions, {wanted}")
    nearest_m = min(p.range_m for p in group)
    if nearest_m > limits.max_range_m:
        return _reject(
            RejectionReason.NEVER_NEAR,
            group,
            f"never nearer than {nearest_m:.1f} m, expected {limits.max_range_m} m",
        )
    pairs = [matches[p.frame_index, p.match_index] for p in group]
    foot, centre, tip = (
        _fit(
            kind,
            group,
            pairs,
            frame_pairs,
            rig,
            map_SE3_left,
            map_SE3_right,
            limits,
            params.position.convergence_m2,
            motion,
        )
        for kind in ("foot", "centre", "tip")
    )
    if foot is None or centre is None or tip is None:
        return _reject(RejectionReason.NOT_CONVERGED, group, "the joint adjustment of all rays found no point")
    height_m = float(tip.xyz_m[2] - foot.xyz_m[2])
    # The pose errors shift foot and tip alike: only the spread of the box edges makes the height uncertain.
    height_sigma_m = float(
        np.sqrt(
            2 / sum((rig.left.fy_px / p.range_m / m.sigma_v_px) ** 2 for p, m in zip(group, pairs, strict=True))
            + 2 * min(p.sigma_outline_m for p in group) ** 2
        )
    )
    if not limits.min_cone_height_m <= height_m <= limits.max_cone_height_m:
        bounds = f"{limits.min_cone_height_m} to {limits.max_cone_height_m} m"
        return _reject(RejectionReason.HEIGHT_IMPLAUSIBLE, group, f"{height_m:.2f} m tall, expected {bounds}")
    own = set(_boxes_of(group, matches))

    def is_anothers(box: Detection) -> bool:
        return (key := _box_key(box)) in in_use and key not in own

    existence = existence_probability(group, height_m, rig, map_SE3_left, detections, params, evidence, is_anothers)
    if existence < limits.min_existence_probability:
        return _reject(
            RejectionReason.EXISTENCE_UNLIKELY,
            group,
            f"existence probability {existence:.2f}, expected at least {limits.min_existence_probability}",
        )
    own_cov = foot.cov_m2 + outline_cov(group, foot.shares, map_SE3_left, rig)
    first, last = (frame_pairs[p.frame_index].captured_at_ns for p in (group[0], group[-1]))
    return Track(
        track_index=index,
        xyz_m=vec3(foot.xyz_m),
        cov_m2=cov3(
            own_cov
            + common_cov(
                group, foot.shares, frame_pairs, rig, map_SE3_left, params.trajectory if motion is None else None
            )
        ),
        relative_cov_m2=cov3(own_cov),
        centre_xyz_m=vec3(centre.xyz_m),
        cone_height_m=height_m,
        cone_height_sigma_m=height_sigma_m,
        existence_probability=existence,
        observation_count=len(group),
        first_seen_ns=first,
        last_seen_ns=last,
        residual_rms_px=float(np.sqrt(np.mean(foot.residuals_px**2))),
        nearest_range_m=nearest_m,
        members=tuple((p.frame_index, p.match_index) for p in group),
        shared_jacobian=jacobian_of(moved_by_calibration(group, foot.shares, rig, map_SE3_left), rig),
    )


def _fit(
    kind: str,
    group: tuple[Position, ...],
    pairs: Sequence[StereoMatch],
    frame_pairs: Mapping[int, FramePair],
    rig: Rig,
    map_SE3_left: Mapping[int, Floats],
    map_SE3_right: Mapping[int, Floats],
    limits: TrackParams,
    convergence_m2: float,
    motion: MotionError | None,
) -> JointFit | None:
    """Joint adjustment of one of the cone's three points over all its stereo pairs."""
    left = np.stack([map_SE3_left[p.frame_index] for p in group])
    right = np.stack([map_SE3_right[p.frame_index] for p in group])
    nearest = min(group, key=lambda p: p.range_m)
    observed = np.array(
        [(*getattr(m, f"{kind}_left_uv_px"), *getattr(m, f"{kind}_right_uv_px")) for m in pairs],
        dtype=np.float64,
    )
    return fit_point(
        observed,
        np.array(nearest.centre_xyz_m if kind == "centre" else nearest.xyz_m),
        left,
        right,
        np.array([rig.left.fx_px, rig.left.fy_px, rig.right.fx_px, rig.right.fy_px]),
        np.array([rig.left.cx_px, rig.left.cy_px, rig.right.cx_px, rig.right.cy_px]),
        sigma_u_px=np.array([m.sigma_u_px for m in pairs]),
        sigma_v_px=np.array([m.sigma_v_px for m in pairs]),
        sigma_pointing_px=np.array([m.sigma_pointing_px for m in pairs]),
        sigma_motion_m=_motion_sigmas(group, nearest, frame_pairs, left, map_SE3_left, limits, motion),
        convergence_m2=convergence_m2,
    )


def _motion_sigmas(
    group: tuple[Position, ...],
    nearest: Position,
    frame_pairs: Mapping[int, FramePair],
    left: Floats,
    map_SE3_left: Mapping[int, Floats],
    limits: TrackParams,
    motion: MotionError | None,
) -> Floats:
    """Sigma (F,) m of where each frame of a group puts the cone, relative to the frame nearest to it."""
    if motion is not None:
        added = [motion(p.frame_index, nearest.frame_index, np.array(p.camera_xyz_m)) for p in group]
        return np.asarray(np.sqrt(np.trace(np.stack(added), axis1=1, axis2=2) / 3))
    driven_m = np.linalg.norm(left[:, :3, 3] - map_SE3_left[nearest.frame_index][:3, 3], axis=1)
    # Relative error of two poses: it grows with the way between them, and never beyond what GNSS leaves open.
    gnss_m = np.array([np.linalg.norm(frame_pairs[p.frame_index].pose.sigma_enu_m) for p in group])
    attitude_m = np.array([max(frame_pairs[p.frame_index].pose.sigma_rpy_rad) * p.range_m for p in group])
    return np.asarray(np.hypot(np.minimum(limits.motion_sigma_relative * driven_m, gnss_m), attitude_m))


def boxes_in_use(
    groups: Iterable[Sequence[Position]], matches: Mapping[tuple[int, int], StereoMatch], limits: TrackParams
) -> set[BoxKey]:
    """Boxes of which the groups are made that are long enough to be tracks. matches: as of `fuse_tracks`."""
    return {box for group in groups if len(group) >= limits.min_observations for box in _boxes_of(group, matches)}


def _boxes_of(group: Sequence[Position], matches: Mapping[tuple[int, int], StereoMatch]) -> Iterator[BoxKey]:
    for position in group:
        match = matches[position.frame_index, position.match_index]
        yield from (_box_key(match.left), _box_key(match.right))


def _box_key(box: Detection) -> BoxKey:
    return box.frame_index, box.side, box.detection_index


def _check_ground(
    tracks: list[Track], rejections: list[Rejection], map_SE3_left: Mapping[int, Floats], limits: TrackParams
) -> tuple[list[Track], list[Rejection]]:
    """Cones stand on the road: refuse tracks whose foot is off the surface on which the others stand.

    The height of a camera above the road is not part of a calibration, so the drive's own cones tell it: the median drop from
    the path (at the point of the path nearest to the cone) to the foot. One track alone has nothing to be compared with.
    """
    if len(tracks) < 3:
        return tracks, rejections
    path = np.stack([pose[:3, 3] for pose in map_SE3_left.values()])
    feet = np.array([t.xyz_m for t in tracks])
    abeam = np.linalg.norm(path[None, :, :2] - feet[:, None, :2], axis=2).argmin(axis=1)
    drops = path[abeam, 2] - feet[:, 2]
    usual = float(np.median(drops))
    kept: list[Track] = []
    for track, drop in zip(tracks, drops.tolist(), strict=True):
        if abs(drop - usual) <= limits.max_ground_distance_m:
            kept.append(track.model_copy(update={"track_index": len(kept)}))
        else:
            rejections.append(
                Rejection(
                    step="tracks",
                    reason=RejectionReason.NOT_ON_GROUND,
                    record=f"track first seen in frame pair {track.members[0][0]}",
                    detail=f"foot {drop:.2f} m below the camera's path, the drive's cones stand {usual:.2f} m below it",
                    payload=track.model_dump(mode="json"),
                )
            )
    return kept, rejections


def _reject(reason: RejectionReason, group: tuple[Position, ...], detail: str) -> Rejection:
    return Rejection(
        step="tracks",
        reason=reason,
        record=f"track of frame pairs {group[0].frame_index} to {group[-1].frame_index}",
        detail=detail,
        payload={
            "members": [[p.frame_index, p.match_index] for p in group],
            "xyz_m": list(group[len(group) // 2].xyz_m),
            "scores": [round(p.score, 3) for p in group],
        },
    )
