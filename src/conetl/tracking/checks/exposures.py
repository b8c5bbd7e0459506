"""When images were taken: by both cameras at one instant, each of one instant only, none lost or repeated by both, and none in
another recording.

A right camera that exposes 5 ms late at 14 m/s is 7 cm farther forward than calibrated, and cones 4 m beside the path are
0.3 m off. Odometry and log hardly show it, but the rows of the right image do: points move away from the middle row in proportion
to row and disparity, y d per baseline. A turn of the camera moves rows by 1 + y^2, x y and x, another focal length by y, and
another principal point by 1, at all distances: all six are estimated together, and sigmas are those of the scatter between the
spans (jackknife).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import chain

import cv2
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion.stereo_motion import RelativeMotion, StereoCameras, triangulate
from conetl.geometry.motion.stereo_tracks import expected_motions, motions_of, shifts_between
from conetl.geometry.packing import vec3
from conetl.geometry.rig import left_SE3_right
from conetl.model.arrays import Floats, Image
from conetl.model.drive import FramePair, Track
from conetl.model.health import HealthCheck, hold_if
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Side
from conetl.perception.visual_odometry import follow_drive
from conetl.perception.working_size import ImageReader

EXPOSURES, DOUBLED = "exposures of both cameras", "images of one instant"
#: Shares of the baseline by which the right camera may be off along the path, and to which that is known at best. Cones 4 m
#: aside are off by 0.08 m then. Sample drives and KITTI: 0.1 to 0.6 %.
_MAX_AHEAD, _FLOOR, _SIGMAS = 0.02, 0.002, 6.0
#: Points are outliers beyond this many sigmas of the median deviation.
_OUTLIER_SIGMAS, _ROUNDS = 3.0, 6
_LEAST_SPANS = 8
#: Objects are doubled where this many pairs, and this share of all objects, are one interval's travel apart (to this many metres)
#: without a third one in that row. Shorter travel does not separate the images of one object.
_LEAST_PAIRS, _PAIRED_SHARE, _APART_M, _LEAST_STEP_M = 4, 0.6, 0.15, 0.3
#: A lost frame shows where the log moves that far in an interval, at an even speed; at most this many intervals are tried.
_UNEVEN_SHARE, _MOST_TRIED = 0.2, 40
#: Images of another path contradict the log by this much (m), and by this many times the change of an even log; it turns
#: by no more than this much (rad) beyond the mean of the intervals before and after.
_ELSEWHERE_M, _EVEN_TIMES = 0.2, 2.0
_EVEN_RAD = np.radians(0.3)
#: Intervals, by their first and second pair counted from the one before, that cross it; and those beside it of equal lengths.
_ACROSS, _BESIDE = ((0, 1), (-1, 1), (0, 2), (-1, 2)), ((-1, 0), (1, 2), (-2, 0), (1, 3))


def right_camera_ahead(cameras: StereoCameras, spans: Sequence[Floats]) -> tuple[float, ...]:
    """How far the right camera is before its calibrated position, and the sigma of that, as shares of the baseline.

    spans: points (N, 4) u_left, v_left, u_right, v_right (px). Empty where they do not determine it.
    """
    if len(spans) < _LEAST_SPANS:
        return ()
    seen = np.concatenate(spans)
    span = np.repeat(np.arange(len(spans)), [len(each) for each in spans])
    points, _, usable = triangulate(cameras, seen[:, :3])
    seen, span, points = seen[usable], span[usable], points[usable]
    right = points @ cameras.right_SE3_left[:3, :3].T + cameras.right_SE3_left[:3, 3]
    x, y = (right[:, :2] / right[:, 2:]).T
    disparity = np.linalg.norm(cameras.right_SE3_left[:3, 3]) / right[:, 2]
    rows = (seen[:, 3] - cameras.right_px[3]) / cameras.right_px[1] - y
    effects = np.column_stack([y * disparity, y, x, x * y, y * y, np.ones_like(y)])
    kept, estimate = np.full(len(rows), True), np.zeros(effects.shape[1])
    for _ in range(_ROUNDS):
        estimate = np.linalg.lstsq(effects[kept], rows[kept], rcond=None)[0]
        rest = np.abs(rows - effects @ estimate)
        kept = rest <= _OUTLIER_SIGMAS * 1.4826 * np.median(rest[kept])
    parts = [(effects[kept & (span == k)], rows[kept & (span == k)]) for k in range(len(spans))]
    normals, sides = np.array([a.T @ a for a, _ in parts]), np.array([a.T @ r for a, r in parts])
    without = normals.sum(axis=0) - normals
    if np.linalg.matrix_rank(without).min() < len(estimate):
        return ()
    others = np.linalg.solve(without, (sides.sum(axis=0) - sides)[:, :, None])[:, 0, 0]
    sigma = np.sqrt((len(spans) - 1) * others.var())
    return float(estimate[0]), float(np.hypot(sigma, _FLOOR))


def check_exposures(ahead: tuple[float, ...], rig: Rig, frame_pairs: Sequence[FramePair]) -> list[HealthCheck]:
    """Whether both cameras expose at the same instant; where not, by how many milliseconds at the speed of the drive."""
    if not ahead:
        return []
    baseline_m = float(np.linalg.norm(left_SE3_right(rig)[:3, 3]))
    off_m, sigma_m, limit_m = baseline_m * np.array([*ahead, _MAX_AHEAD])
    wrong = abs(off_m) > max(limit_m, _SIGMAS * sigma_m)
    detail = "The position of the right camera agrees with the calibration."
    if wrong:
        path = np.array([pair.pose.map_t_body_m for pair in frame_pairs])
        seconds = np.diff([pair.captured_at_ns for pair in frame_pairs]) / 1e9
        speed_m_s = max(float(np.median(np.linalg.norm(np.diff(path, axis=0), axis=1) / seconds)), 1e-3)
        detail = (
            f"The right camera is {abs(off_m):.3f} +- {sigma_m:.3f} m {'ahead of' if off_m > 0 else 'behind'} its calibrated "
            f"position: at {speed_m_s:.1f} m/s it exposes {abs(off_m) / speed_m_s * 1e3:.1f} ms too "
            f"{'late' if off_m > 0 else 'early'}. Trigger both cameras together. If they are, check that both have the same "
            "brightness curve (gamma, contrast; a different one has the same effect), or calibrate the rig (conetl calibrate)."
        )
    return [hold_if(wrong, EXPOSURES, detail, value=off_m, sigma=sigma_m, limit=limit_m, unit="m")]


def check_doubled(tracks: Sequence[Track], frame_pairs: Sequence[FramePair]) -> HealthCheck:
    """Whether each image shows two instants, as interlaced video does and frames that a converter blended: all objects stand
    twice then, one interval's travel apart. In a real row of that spacing most have neighbours on both sides."""
    path = {pair.frame_index: np.array(pair.pose.map_t_body_m) for pair in frame_pairs}
    steps = {frame: path[frame + 1] - path[frame] for frame in path if frame + 1 in path}
    frames = [steps.keys() & {frame for frame, _ in track.members} for track in tracks]
    following: list[tuple[int, int]] = []
    if tracks and steps:
        near_m = 2 * float(np.median([np.linalg.norm(step) for step in steps.values()])) + _APART_M
        near = cKDTree(np.array([track.xyz_m[:2] for track in tracks])).query_pairs(near_m, output_type="ndarray")
        for i, j in np.concatenate([near, near[:, ::-1]]).tolist():
            common = frames[i] & frames[j]
            if not common or 2 * len(common) < min(len(frames[i]), len(frames[j])):
                continue
            step = np.mean([steps[frame] for frame in common], axis=0)
            off = np.subtract(tracks[j].xyz_m, tracks[i].xyz_m) - step
            if np.linalg.norm(step[:2]) > _LEAST_STEP_M and np.linalg.norm(off[:2]) < _APART_M:
                following.append((i, j))
    ends = Counter(chain.from_iterable(following))
    pairs = sum(ends[i] == ends[j] == 1 for i, j in following)
    wrong = pairs >= _LEAST_PAIRS and 2 * pairs >= _PAIRED_SHARE * len(tracks)
    detail = "No objects appear twice."
    if wrong:
        detail = (
            f"{2 * pairs} of {len(tracks)} objects form pairs at the distance driven in one interval: each image shows two "
            "instants, because the video is interlaced, or because frames were blended when the frame rate was converted. "
            "Deinterlace the video, or export it at its original frame rate."
        )
    share = 2 * pairs / len(tracks) if tracks else None
    return hold_if(wrong, DOUBLED, detail, value=share, limit=_PAIRED_SHARE)


def check_lost_frames(
    pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    read: ImageReader,
    params: TrajectoryParams,
) -> HealthCheck:
    """Whether both cameras lost or repeated a frame: between two frame pairs the images move twice or half as far as a smooth
    log, and all later images have other poses than their numbers or time stamps state.

    At speed odometry finds such a motion only if it starts from a guess of that length, so intervals that it did not measure are
    followed again. read: grey images of a frame pair.
    """
    at_s = np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9
    lengths_m = np.linalg.norm(np.diff([pair.pose.map_t_body_m for pair in pairs], axis=0), axis=1)
    speeds = lengths_m / np.maximum(np.diff(at_s), 1e-6)
    even = np.abs(speeds[1:-1] - (speeds[:-2] + speeds[2:]) / 2) < _UNEVEN_SHARE * speeds[1:-1]
    ratios = np.linalg.norm(shifts_between(pairs, motions), axis=1)
    ratios /= [max(float(np.linalg.norm(expected[:3, 3])), 1e-6) for expected in expected_motions(pairs, rig)]
    usual = np.abs(ratios - 1) < 2 * _UNEVEN_SHARE
    alone = even & usual[:-2] & ~usual[1:-1] & usual[2:] & (lengths_m[1:-1] > _LEAST_STEP_M)
    suspected = (np.flatnonzero(alone) + 1).tolist()
    found = [
        pairs[k + 1].frame_index
        for k in evenly_spaced(suspected, _MOST_TRIED)
        if any(
            _is_about(ratios[k], factor)
            or (np.isnan(ratios[k]) and _moves_by(factor, pairs[k], pairs[k + 1], rig, read, params))
            for factor in (2.0, 0.5)
        )
    ]
    detail = "No frame was lost or repeated by both cameras."
    if found:
        detail = (
            f"Both cameras lost a frame or repeated one before frame pair {found[0]}: there the images move twice or half as far "
            "as GNSS/INS, so all later images have wrong poses. Correct the numbers or time stamps of the images."
        )
    return hold_if(found, "frames lost by both cameras", detail, value=float(len(found)), limit=0.0)


def _moves_by(
    factor: float, first: FramePair, second: FramePair, rig: Rig, read: ImageReader, params: TrajectoryParams
) -> bool:
    """Whether the images of two frame pairs show this many times the motion of their poses."""
    start, end = np.array(first.pose.map_t_body_m), np.array(second.pose.map_t_body_m)
    both = first, second.with_pose(map_t_body_m=vec3(start + factor * (end - start)))
    [motion] = motions_of(follow_drive(both, rig, read, params), both, rig, params)
    expected_m = float(np.linalg.norm(expected_motions(both, rig)[0][:3, 3]))
    return _is_about(float(np.linalg.norm(motion.shift_m())) / expected_m, 1.0)


def _is_about(ratio: float, factor: float) -> bool:
    return bool(abs(ratio - factor) < _UNEVEN_SHARE * factor)


def check_recording(
    pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    read: ImageReader,
    params: TrajectoryParams,
) -> HealthCheck:
    """Whether images of another recording begin somewhere: there the images depart from the log, although the log is smooth.

    The motions before and after agree with the log. The one between them contradicts it, and so do all motions across it; or none
    of these can be measured, although those beside it can. read: grey images of a frame pair.
    """
    expected = np.array(expected_motions(pairs, rig))
    off_m = shifts_between(pairs, motions) - expected[:, :3, 3]
    sizes_m = np.linalg.norm(off_m, axis=1)
    seconds = np.diff([pair.captured_at_ns for pair in pairs]) * 1e-9
    turns = Rotation.from_matrix(expected[:, :3, :3]).as_rotvec()
    uneven_m, uneven_rad, uneven_s = (
        np.linalg.norm(x[1:-1] - (x[:-2] + x[2:]) / 2, axis=1) for x in (expected[:, :3, 3], turns, seconds[:, None])
    )
    even = (uneven_m < _ELSEWHERE_M / _EVEN_TIMES) & (uneven_rad < _EVEN_RAD) & (uneven_s < seconds[1:-1] / 2)
    usual = sizes_m < _ELSEWHERE_M / _EVEN_TIMES
    suspected = np.flatnonzero(even & usual[:-2] & ~(sizes_m[1:-1] < _ELSEWHERE_M) & usual[2:]) + 1
    found = [
        pairs[k].frame_index
        for k in evenly_spaced(suspected.tolist(), _MOST_TRIED)
        if _goes_elsewhere(k, off_m[k], pairs, rig, read, params)
    ]
    detail = "Images and GNSS/INS show the same path."
    if found:
        detail = (
            f"After frame pair {' and '.join(map(str, found))} the images jump and GNSS/INS does not, while both agree before "
            "and after: images of another recording are mixed with these, or frames were lost. Check the names and numbers of "
            "the images."
        )
    return hold_if(found, "images of one recording", detail, value=float(len(found)), limit=0.0)


def _goes_elsewhere(
    k: int, off_m: Floats, pairs: Sequence[FramePair], rig: Rig, read: ImageReader, params: TrajectoryParams
) -> bool:
    """Whether all motions across the interval after pair k agree with it. off_m (3,): NaN where it was not measured."""

    def evened(pair: FramePair, side: Side) -> Image:
        return np.asarray(cv2.equalizeHist(read(pair, side)))  # the exposure may change from one image to the next

    def off_of(first: int, second: int) -> Floats:
        both = pairs[k + first], pairs[k + second]
        [motion] = motions_of(follow_drive(both, rig, evened, params), both, rig, params)
        return np.asarray(motion.shift_m() - expected_motions(both, rig)[0][:3, 3])

    across = np.array([off_of(*ends) for ends in _ACROSS])
    if np.isnan(off_m).any():
        beside = np.array([off_of(*ends) for ends in _BESIDE if k + ends[0] >= 0 and k + ends[1] < len(pairs)])
        return bool(np.isnan(across).all() and (np.linalg.norm(beside, axis=1) < _ELSEWHERE_M).all())
    known = across[~np.isnan(across[:, 0])]
    return len(known) > 1 and bool((np.linalg.norm(known - off_m, axis=1) < np.linalg.norm(off_m) / 2).all())
