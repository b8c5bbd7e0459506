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
from conetl.model.arrays import Bools, Floats, Image, Ints
from conetl.model.check_params import ExposureCheckParams
from conetl.model.drive import FramePair, Track
from conetl.model.health import Finding
from conetl.model.params import TrajectoryParams
from conetl.model.rig import Rig, Side
from conetl.perception.visual_odometry import follow_drive
from conetl.perception.working_size import ImageReader
from conetl.tracking.log.log_errors import SIGMA_OF_MEDIAN
from conetl.tracking.self_calibration import DOUBTFUL_SIGMAS, is_ahead

EXPOSURES, DOUBLED = "exposures of both cameras", "images of one instant"
_DEFAULT = ExposureCheckParams()
#: Share of the baseline to which the offset of the right camera along the path is known at best.
_FLOOR = 0.002
#: Distance of cones from the path in which the effect of the offset is stated; most are nearer.
_BESIDE_M = 4.0
#: Points are outliers beyond this many sigmas of the median deviation.
_OUTLIER_SIGMAS, _ROUNDS = 3.0, 6
_LEAST_SPANS = 8
#: Speeds that differ by less than this share of their mean are one.
_LEAST_CHANGE = 0.02
#: Objects are one interval's travel apart to this many metres; shorter travel does not separate the images of one object.
_APART_M, _LEAST_STEP_M = 0.15, 0.3
#: Images contradict a log by this many sigmas of its scatter against them.
_CLEAR_SIGMAS = 8.0
#: At most this many intervals are tried.
_MOST_TRIED = 40
#: Images of another path contradict the log by this many times the change of an even log, which turns by no more than this much
#: (rad) beyond the mean of the intervals before and after.
_EVEN_TIMES = 2.0
_EVEN_RAD = np.radians(0.3)
#: Intervals, by their first and second pair counted from the one before, that cross it; and those beside it of equal lengths.
_ACROSS, _BESIDE = ((0, 1), (-1, 1), (0, 2), (-1, 2)), ((-1, 0), (1, 2), (-2, 0), (1, 3))


def right_camera_ahead(
    cameras: StereoCameras, spans: Sequence[Floats], speeds_m_s: Sequence[float]
) -> tuple[float, ...]:
    """How far the right camera is before its calibrated position at the mean speed, and the sigma of that, as shares of the
    baseline; also how much of it grows with the speed, and its sigma, if the speed changes.

    spans: points (N, 4) u_left, v_left, u_right, v_right (px); speeds: of each span. Empty where they do not determine the
    offset. A camera that exposes late is the farther ahead the faster it drives, one that is mounted elsewhere is not.
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
    speeds = np.asarray(speeds_m_s) / max(float(np.mean(speeds_m_s)), 1e-3) - 1
    effects = np.column_stack([y * disparity, speeds[span] * y * disparity, y, x, x * y, y * y, np.ones_like(y)])
    if np.ptp(speeds) < _LEAST_CHANGE:
        effects = np.delete(effects, 1, axis=1)
    kept, estimate = np.full(len(rows), True), np.zeros(effects.shape[1])
    for _ in range(_ROUNDS):
        estimate = np.linalg.lstsq(effects[kept], rows[kept], rcond=None)[0]
        rest = np.abs(rows - effects @ estimate)
        kept = rest <= _OUTLIER_SIGMAS * 1.4826 * np.median(rest[kept])
    # Errors that repeat in all spans, as of a lens, differ from one part of the image to another, or from near to far points.
    thirds = np.minimum((3 * seen[:, 0] / (2 * cameras.left_px[2])).astype(int), 2)
    blocks = thirds + 3 * (disparity > np.median(disparity)) + 6 * (y > 0)
    by_span, by_block = (_jackknife(effects[kept], rows[kept], part[kept]) for part in (span, blocks))
    if by_span is None or by_block is None:
        return ()
    sigma = np.sqrt((by_span + by_block)[:2])
    found = float(estimate[0]), float(np.hypot(sigma[0], _FLOOR))
    return found if np.ptp(speeds) < _LEAST_CHANGE else (*found, float(estimate[1]), float(sigma[1]))


def _jackknife(effects: Floats, rows: Floats, part: Ints) -> Floats | None:
    """(P,) variance of least squares from its scatter without one of the parts (N,) each; None if that is not determined."""
    numbers = np.unique(part)
    parts = [(effects[part == k], rows[part == k]) for k in numbers]
    normals, sides = np.array([a.T @ a for a, _ in parts]), np.array([a.T @ r for a, r in parts])
    without = normals.sum(axis=0) - normals
    if len(numbers) < 2 or np.linalg.matrix_rank(without).min() < effects.shape[1]:
        return None
    others = np.linalg.solve(without, (sides.sum(axis=0) - sides)[:, :, None])[:, :, 0]
    return np.asarray((len(numbers) - 1) * others.var(axis=0))


def check_exposures(
    ahead: tuple[float, ...], rig: Rig, frame_pairs: Sequence[FramePair], limits: ExposureCheckParams = _DEFAULT
) -> list[Finding]:
    """Whether both cameras expose at the same instant; where not, by how many milliseconds at the speed of the drive, which takes
    two frame pairs."""
    if not ahead or len(frame_pairs) < 2:
        return []
    baseline_m = float(np.linalg.norm(left_SE3_right(rig)[:3, 3]))
    off_m, sigma_m, limit_m = (baseline_m * np.array([*ahead[:2], limits.max_ahead_share])).tolist()
    path = np.array([pair.pose.map_t_body_m for pair in frame_pairs])
    seconds = np.diff([pair.captured_at_ns for pair in frame_pairs]) / 1e9
    speed_m_s = max(float(np.median(np.linalg.norm(np.diff(path, axis=0), axis=1) / seconds)), 1e-3)
    where, when = ("ahead of", "late") if off_m > 0 else ("behind", "early")
    facts = {"speed_m_s": speed_m_s, "late_ms": abs(off_m) / speed_m_s * 1e3, "where": where, "when": when}
    finding = Finding(
        check=EXPOSURES, value=off_m, sigma=sigma_m, limit=limit_m, facts=facts, says=("", _cause(ahead), "covered")
    )
    effect_m = abs(off_m) * abs(_BESIDE_M - baseline_m) / baseline_m
    return [finding.model_copy(update={"treated": "widened" if is_ahead(ahead) else "", "effect_m": effect_m})]


def _cause(ahead: tuple[float, ...]) -> str:
    """Name of the message on the cause: a wrong trigger and a wrong mount differ only where the speed changes."""
    if len(ahead) == 2 or abs(ahead[0]) < DOUBTFUL_SIGMAS * ahead[3]:
        return "either"
    grows, stays = (abs(ahead[2] - expected) < DOUBTFUL_SIGMAS * ahead[3] for expected in (ahead[0], 0.0))
    return "trigger" if grows and not stays else "mount" if stays and not grows else "either"


def check_doubled(
    tracks: Sequence[Track], frame_pairs: Sequence[FramePair], limits: ExposureCheckParams = _DEFAULT
) -> Finding:
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
    share = 2 * pairs / len(tracks) if tracks else None
    found = pairs >= limits.least_doubled_pairs and 2 * pairs >= limits.max_doubled_share * len(tracks)
    facts = {"doubled": 2 * pairs, "objects": len(tracks)}
    return Finding(check=DOUBLED, value=share, found=found, limit=limits.max_doubled_share, facts=facts)


def check_lost_frames(
    pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    read: ImageReader,
    params: TrajectoryParams,
    limits: ExposureCheckParams = _DEFAULT,
) -> Finding:
    """Whether both cameras lost or repeated a frame: between two frame pairs the images move twice or half as far as a smooth
    log, and all later images have other poses than their numbers or time stamps state.

    At speed odometry finds such a motion only if it starts from a guess of that length, so intervals that it did not measure are
    followed again. read: grey images of a frame pair.
    """
    at_s = np.array([pair.captured_at_ns - pairs[0].captured_at_ns for pair in pairs]) * 1e-9
    lengths_m = np.linalg.norm(np.diff([pair.pose.map_t_body_m for pair in pairs], axis=0), axis=1)
    speeds = lengths_m / np.maximum(np.diff(at_s), 1e-6)
    uneven = limits.uneven_share
    even = np.abs(speeds[1:-1] - (speeds[:-2] + speeds[2:]) / 2) < uneven * speeds[1:-1]
    ratios = np.linalg.norm(shifts_between(pairs, motions), axis=1)
    expected_m = np.array(
        [max(float(np.linalg.norm(expected[:3, 3])), 1e-6) for expected in expected_motions(pairs, rig)]
    )
    ratios /= expected_m
    usual = np.abs(ratios - 1) < 2 * uneven
    alone = even & usual[:-2] & ~usual[1:-1] & usual[2:] & (lengths_m[1:-1] > _LEAST_STEP_M)
    alone &= _is_clear((ratios - 1) * expected_m)[1:-1]
    suspected = (np.flatnonzero(alone) + 1).tolist()

    def ratio(k: int, factor: float) -> float:
        """How many times as long the images show an interval, searched around a factor if it was not measured."""
        if not np.isnan(ratios[k]):
            return float(ratios[k])
        start, end = (np.array(pair.pose.map_t_body_m) for pair in pairs[k : k + 2])
        longer = pairs[k + 1].with_pose(map_t_body_m=vec3(start + factor * (end - start)))
        shift_m, expected_m = np.linalg.norm(_shifts_m(pairs[k], longer, rig, read, params), axis=1)
        return float(factor * shift_m / expected_m)

    found = [
        pairs[k + 1].frame_index
        for k in evenly_spaced(suspected, _MOST_TRIED)
        if any(abs(ratio(k, factor) - factor) < uneven * factor for factor in (2.0, 0.5))
    ]
    facts = {"first": found[0]} if found else {}
    return Finding(check="frames lost by both cameras", value=float(len(found)), facts=facts)


def _is_clear(off_m: Floats) -> Bools:
    """(N,): which differences (N,) between images and log exceed the scatter of most; so do those that were not measured."""
    if np.isnan(off_m).all():
        return np.ones(len(off_m), dtype=bool)
    off_m = np.abs(off_m - np.nanmedian(off_m))
    return np.asarray(~(off_m < _CLEAR_SIGMAS * SIGMA_OF_MEDIAN * np.nanmedian(off_m)))


def _shifts_m(first: FramePair, second: FramePair, rig: Rig, read: ImageReader, params: TrajectoryParams) -> Floats:
    """(2, 3): by how much the camera moves between two frame pairs by their images (NaN: not measured), and by their poses."""
    both = first, second
    [motion] = motions_of(follow_drive(both, rig, read, params), both, rig, params)
    return np.stack([motion.shift_m(), expected_motions(both, rig)[0][:3, 3]])


def check_recording(
    pairs: Sequence[FramePair],
    rig: Rig,
    motions: Sequence[RelativeMotion],
    read: ImageReader,
    params: TrajectoryParams,
    limits: ExposureCheckParams = _DEFAULT,
) -> Finding:
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
    even = (uneven_m < limits.elsewhere_m / _EVEN_TIMES) & (uneven_rad < _EVEN_RAD) & (uneven_s < seconds[1:-1] / 2)
    usual = sizes_m < limits.elsewhere_m / _EVEN_TIMES
    clear = _is_clear(sizes_m)[1:-1] & ~(sizes_m[1:-1] < limits.elsewhere_m)
    suspected = np.flatnonzero(even & usual[:-2] & clear & usual[2:]) + 1
    found = [
        pairs[k].frame_index
        for k in evenly_spaced(suspected.tolist(), _MOST_TRIED)
        if _goes_elsewhere(k, off_m[k], pairs, rig, read, params, limits.elsewhere_m)
    ]
    facts = {"frames": " and ".join(map(str, found))}
    return Finding(check="images of one recording", value=float(len(found)), facts=facts)


def _goes_elsewhere(
    k: int,
    off_m: Floats,
    pairs: Sequence[FramePair],
    rig: Rig,
    read: ImageReader,
    params: TrajectoryParams,
    elsewhere_m: float,
) -> bool:
    """Whether all motions across the interval after pair k agree with it. off_m (3,): NaN where it was not measured."""

    def evened(pair: FramePair, side: Side) -> Image:
        return np.asarray(cv2.equalizeHist(read(pair, side)))  # the exposure may change from one image to the next

    def off_of(ends: Sequence[tuple[int, int]]) -> Floats:
        inside = [(k + first, k + second) for first, second in ends if k + first >= 0 and k + second < len(pairs)]
        shifts_m = [_shifts_m(pairs[first], pairs[second], rig, evened, params) for first, second in inside]
        return np.array([in_images - in_log for in_images, in_log in shifts_m])

    across = off_of(_ACROSS)
    if np.isnan(off_m).any():
        beside = off_of(_BESIDE)
        return bool(np.isnan(across).all() and (np.linalg.norm(beside, axis=1) < elsewhere_m).all())
    known = across[~np.isnan(across[:, 0])]
    return len(known) > 1 and bool((np.linalg.norm(known - off_m, axis=1) < np.linalg.norm(off_m) / 2).all())
