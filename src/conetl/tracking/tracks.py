"""Positions of one drive -> tracks: one joint adjustment per physical cone, and the probability that it is a cone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from conetl.geometry.calibration.covariance import jacobian_of, shared_cov
from conetl.geometry.intersection import JointFit, fit_point
from conetl.geometry.packing import cov3, vec3
from conetl.geometry.rig import map_SE3_camera, map_SE3_left
from conetl.model.arrays import Floats
from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence, class_evidence
from conetl.model.drive import CommonError, Detection, FramePair, Position, StereoMatch, Track
from conetl.model.feature_classes import FEATURE_CLASSES, noun_of
from conetl.model.params import IngestParams, TrackParams
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import Rig, Side
from conetl.tracking.association import CameraMotion, MotionError, chain_positions
from conetl.tracking.error_propagation import (
    class_error_id,
    common_cov,
    moved_by_calibration,
    outline_jacobian,
    shared_by_drives,
    track_shares,
)
from conetl.tracking.existence import existence_probability
from conetl.tracking.matching.covariance import own_disparity_px

#: Frame, side and number of a detection.
BoxKey = tuple[int, Side, int]


@dataclass(frozen=True)
class DriveData:
    """What tracks of a drive are computed from, beside its positions."""

    matches: Mapping[tuple[int, int], StereoMatch]
    """By (frame_index, match_index)."""
    detections: Mapping[int, Sequence[Detection]]
    """Of both images, by frame index."""
    frame_pairs: Mapping[int, FramePair]
    """With the poses that the positions were computed with."""
    rig: Rig
    params: IngestParams
    evidence: DetectorEvidence
    """Figures of the detector."""
    motion: MotionError | None
    """Error of the relative motion of a refined trajectory; without it the shares in `params.track` hold."""
    common_errors: Sequence[CommonError] = ()
    """Of the positions of the body; other drives share them."""
    corrected: bool = False
    """Whether control points correct the poses."""

    @cached_property
    def map_SE3_left(self) -> Mapping[int, Floats]:
        """(4, 4) camera -> map, by frame index."""
        return {index: map_SE3_left(pair.pose, self.rig) for index, pair in self.frame_pairs.items()}

    @cached_property
    def map_SE3_right(self) -> Mapping[int, Floats]:
        """As `map_SE3_left`."""
        return {index: map_SE3_camera(pair.pose, self.rig, "right") for index, pair in self.frame_pairs.items()}


def drive_data(
    frame_pairs: Iterable[FramePair],
    rig: Rig,
    detections: Iterable[Detection],
    matches: Iterable[StereoMatch],
    params: IngestParams,
    evidence: DetectorEvidence = UNMEASURED,
    motion: MotionError | None = None,
    *,
    common_errors: Sequence[CommonError] = (),
    corrected: bool = False,
) -> DriveData:
    """The observations of a drive indexed by frame. detections: of both images; all others: see `DriveData`."""
    by_frame: dict[int, list[Detection]] = defaultdict(list)
    for detection in detections:
        by_frame[detection.frame_index].append(detection)
    match_of = {(m.frame_index, m.match_index): m for m in matches}
    pairs = {pair.frame_index: pair for pair in frame_pairs}
    return DriveData(match_of, by_frame, pairs, rig, params, evidence, motion, common_errors, corrected)


def fuse_tracks(
    positions: Sequence[Position], data: DriveData, *, seen_in: int | None = None
) -> tuple[list[Track], list[Rejection]]:
    """Fuse the positions of one drive into tracks.

    A group that is too short, never near, off the road surface, of implausible height or unlikely to be a cone is rejected with
    the reason. seen_in: only objects with a position in this frame.
    """
    tracks: list[Track] = []
    rejections: list[Rejection] = []
    limits = data.params.track
    groups = chain_positions(positions, CameraMotion(data.map_SE3_left, limits, data.motion))
    in_use = boxes_in_use(groups, data.matches, limits)
    for group in sorted(groups, key=lambda g: (g[0].frame_index, g[0].match_index)):
        if seen_in is not None and all(p.frame_index != seen_in for p in group):
            continue
        result = fuse_group(len(tracks), group, data, in_use)
        if isinstance(result, Track):
            tracks.append(result)
        else:
            rejections.append(result)
    return _check_ground(tracks, rejections, data.map_SE3_left, limits)


def fuse_group(
    index: int, group: tuple[Position, ...], data: DriveData, in_use: Collection[BoxKey]
) -> Track | Rejection:
    """The track of one group of positions, or its rejection; in_use: boxes of all groups."""
    limits, rig = data.params.track, data.rig
    if len(group) < limits.min_observations:
        detail = f"{len(group)} of at least {limits.min_observations} positions: too few to be evidence of an object"
        return _reject(RejectionReason.TOO_FEW_OBSERVATIONS, group, detail)
    nearest_m = min(p.range_m for p in group)
    if nearest_m > limits.max_range_m:
        detail = f"never nearer than {nearest_m:.1f} m, expected {limits.max_range_m} m"
        return _reject(RejectionReason.NEVER_NEAR, group, detail)
    matches = [data.matches[p.frame_index, p.match_index] for p in group]
    foot, centre, tip = _fit_points(group, matches, data)
    if foot is None or centre is None or tip is None:
        return _reject(RejectionReason.NOT_CONVERGED, group, "the joint adjustment of all rays found no point")
    height_m = float(tip.xyz_m[2] - foot.xyz_m[2])
    category = _category_of(group)
    least_m, most_m = limits.heights_m(category)
    if not least_m <= height_m <= most_m:
        detail = f"{noun_of(category)} {height_m:.2f} m tall, expected {least_m} to {most_m} m"
        return _reject(RejectionReason.HEIGHT_IMPLAUSIBLE, group, detail)
    own = set(_boxes_of(group, data.matches))

    def is_of_other(box: Detection) -> bool:
        return (key := _box_key(box)) in in_use and key not in own

    existence = existence_probability(
        group, height_m, rig, data.map_SE3_left, data.detections, data.params,
        class_evidence(data.evidence, category), is_of_other, category,
    )  # fmt: skip
    if existence < limits.min_existence_probability:
        detail = f"existence probability {existence:.2f}, expected at least {limits.min_existence_probability}"
        return _reject(RejectionReason.EXISTENCE_UNLIKELY, group, detail)
    outline = outline_jacobian(group, foot.shares, data.map_SE3_left, rig)
    of_class = FEATURE_CLASSES[category].outline_common ** 0.5 * outline
    own_cov = foot.cov_m2 + outline @ outline.T - of_class @ of_class.T
    log = data.params.trajectory if data.motion is None else None
    of_drive = common_cov(group, foot.shares, data.frame_pairs, rig, data.map_SE3_left, log)
    calibrated = moved_by_calibration(group, foot.shares, rig, data.map_SE3_left)
    poses = [data.frame_pairs[p.frame_index].pose for p in group]
    common, lacking = shared_by_drives(
        data.common_errors, foot.shares, poses, of_drive - shared_cov(calibrated, rig), corrected=data.corrected
    )
    shared = [(class_error_id(category), of_class), *common] if of_class.any() else common
    first, last = (data.frame_pairs[p.frame_index].captured_at_ns for p in (group[0], group[-1]))
    return Track(
        track_index=index,
        category=category,
        xyz_m=vec3(foot.xyz_m),
        cov_m2=cov3(own_cov + of_class @ of_class.T + of_drive + lacking),
        relative_cov_m2=cov3(own_cov + _changed_by_motion(group, foot, data)),
        centre_xyz_m=vec3(centre.xyz_m),
        object_height_m=height_m,
        object_height_sigma_m=_height_sigma_m(group, matches, rig, FEATURE_CLASSES[category].height_common * height_m),
        existence_probability=existence,
        observation_count=len(group),
        first_seen_ns=first,
        last_seen_ns=last,
        residual_rms_px=float(np.sqrt(np.mean(foot.residuals_px**2))),
        nearest_range_m=nearest_m,
        members=tuple((p.frame_index, p.match_index) for p in group),
        shared_jacobian=jacobian_of(calibrated, rig, shared),
    )


def _fit_points(
    group: tuple[Position, ...], matches: Sequence[StereoMatch], data: DriveData
) -> Iterator[JointFit | None]:
    """Foot, centre and tip of an object, each from the image points of all its matches; None where no point is found."""
    left = np.stack([data.map_SE3_left[p.frame_index] for p in group])
    right = np.stack([data.map_SE3_right[p.frame_index] for p in group])
    nearest = min(group, key=lambda p: p.range_m)
    sigma_motion_m = _motion_sigmas(group, nearest, left, data)
    sigma_u_px = np.array([m.sigma_u_px for m in matches])
    # `outline_jacobian` adds once what all observations share, as they do not average it out; here it must not count again. A
    # disparity is the difference of two columns, hence the square roots of 2.
    sharing = np.array([m.sigma_outline_px > 0 for m in matches])
    sigma_u_px[sharing] = [own_disparity_px(px) / 2**0.5 for px in 2**0.5 * sigma_u_px[sharing]]
    for point in ("foot", "centre", "tip"):
        yield fit_point(
            np.array([(*getattr(m, f"{point}_left_uv_px"), *getattr(m, f"{point}_right_uv_px")) for m in matches]),
            np.array(nearest.centre_xyz_m if point == "centre" else nearest.xyz_m),
            left,
            right,
            data.rig,
            sigma_u_px=sigma_u_px,
            sigma_v_px=np.array([m.sigma_v_px for m in matches]),
            sigma_pointing_px=np.array([m.sigma_pointing_px for m in matches]),
            sigma_motion_m=sigma_motion_m,
            convergence_m2=data.params.position.convergence_m2,
        )


def _height_sigma_m(group: Sequence[Position], matches: Sequence[StereoMatch], rig: Rig, common_m: float) -> float:
    """Sigma of an object's height: pose errors shift foot and tip equally, so only the errors of the box edges count.

    common_m: sigma of what the heights of the class have in common.
    """
    weight = sum((rig.left.fy_px / p.range_m / m.sigma_v_px) ** 2 for p, m in zip(group, matches, strict=True))
    return float(np.sqrt(2 / weight + 2 * min(p.sigma_outline_m for p in group) ** 2 + common_m**2))


def _changed_by_motion(group: tuple[Position, ...], foot: JointFit, data: DriveData) -> Floats:
    """What the covariance of relative motion adds to that of the fit, (3, 3) m^2.

    The fit takes pose errors to be independent from frame to frame. Those of the scale of all motions, which few positions hardly
    show, stretch a whole track.
    """
    if data.motion is None or data.motion.changed_cov_m2 is None:
        return np.zeros((3, 3))
    frames = [p.frame_index for p in group]
    by_frames = track_shares(group, [data.frame_pairs[k].pose for k in frames], data.rig, data.motion)
    changed: Floats = data.motion.changed_cov_m2(foot.xyz_m[None], [frames], [by_frames])
    return foot.of_images_m2 + changed - foot.cov_m2


def _category_of(group: Sequence[Position]) -> str:
    """The class of one object: that of the greatest sum of scores of its boxes."""
    scores: defaultdict[str, float] = defaultdict(float)
    for position in group:
        scores[position.category] += position.score
    return max(sorted(scores), key=scores.__getitem__)


def _motion_sigmas(group: tuple[Position, ...], nearest: Position, left: Floats, data: DriveData) -> Floats:
    """Sigma (F,) m of the cone's position from each frame of a group, relative to the frame nearest to the cone."""
    if data.motion is not None:
        added = [data.motion.cov_m2(p.frame_index, nearest.frame_index, np.array(p.camera_xyz_m)) for p in group]
        return np.asarray(np.sqrt(np.trace(np.stack(added), axis1=1, axis2=2) / 3))
    driven_m = np.linalg.norm(left[:, :3, 3] - data.map_SE3_left[nearest.frame_index][:3, 3], axis=1)
    # The relative error of two poses grows with the distance between them, up to the error of GNSS.
    poses = [data.frame_pairs[p.frame_index].pose for p in group]
    gnss_m = np.array([np.linalg.norm(pose.sigma_enu_m) for pose in poses])
    attitude_m = np.array([max(pose.sigma_rpy_rad) * p.range_m for pose, p in zip(poses, group, strict=True)])
    relative = data.params.track.motion_sigma_relative
    return np.asarray(np.hypot(np.minimum(relative * driven_m, gnss_m), attitude_m))


def boxes_in_use(
    groups: Iterable[Sequence[Position]], matches: Mapping[tuple[int, int], StereoMatch], limits: TrackParams
) -> set[BoxKey]:
    """Boxes of the groups that are long enough to be tracks; matches by (frame_index, match_index)."""
    return {box for group in groups if len(group) >= limits.min_observations for box in _boxes_of(group, matches)}


def _boxes_of(group: Sequence[Position], matches: Mapping[tuple[int, int], StereoMatch]) -> Iterator[BoxKey]:
    for position in group:
        match = matches[position.frame_index, position.match_index]
        yield from map(_box_key, match.boxes)


def _box_key(box: Detection) -> BoxKey:
    return box.frame_index, box.side, box.detection_index


def _check_ground(
    tracks: list[Track], rejections: list[Rejection], map_SE3_left: Mapping[int, Floats], limits: TrackParams
) -> tuple[list[Track], list[Rejection]]:
    """Reject tracks whose foot is off the road surface, as given by the drive's other tracks.

    The height of a camera above the road is not part of a calibration: it is the median drop from the path (at its point
    nearest to the cone) to the foot. Fewer than three tracks are not checked, nor are plates of signs.
    """
    standing = np.array([FEATURE_CLASSES[track.category].on_road for track in tracks], dtype=bool)
    if standing.sum() < 3:
        return tracks, rejections
    path = np.stack([pose[:3, 3] for pose in map_SE3_left.values()])
    feet = np.array([t.xyz_m for t in tracks])
    abeam = np.linalg.norm(path[None, :, :2] - feet[:, None, :2], axis=2).argmin(axis=1)
    drops = path[abeam, 2] - feet[:, 2]
    usual = float(np.median(drops[standing]))
    kept: list[Track] = []
    for track, drop, on_road in zip(tracks, drops.tolist(), standing.tolist(), strict=True):
        if not on_road or abs(drop - usual) <= limits.max_ground_distance_m:
            kept.append(track.model_copy(update={"track_index": len(kept)}))
        else:
            detail = f"foot {drop:.2f} m below the drive path; expected {usual:.2f} m, as of the drive's cones"
            rejections.append(rejected_track(RejectionReason.NOT_ON_GROUND, track, detail))
    return kept, rejections


def rejected_track(reason: RejectionReason, track: Track, detail: str) -> Rejection:
    """The rejection of a track that other tracks of the drive, or its own observations, show to be wrong."""
    return Rejection(
        step="tracks", reason=reason, record=f"track first seen in frame pair {track.members[0][0]}", detail=detail,
        payload=track.model_dump(mode="json"),
    )  # fmt: skip


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
