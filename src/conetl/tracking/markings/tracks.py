"""Points of lane markings of one drive -> tracks: their course, attributes and covariances.

The course is piecewise linear between vertices at equal distances along the drive's path, fitted to the points' offsets and
heights by robust least squares with a small penalty on its bend and changes of it, which continues it across gaps. So a vertex
is a weighted mean of points of several frame pairs, and errors of poses and calibration move it with the same weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from uuid import UUID

import numpy as np
from scipy.ndimage import uniform_filter1d

from conetl.geometry.calibration.covariance import calibration_jacobian, jacobian_of, shared_cov
from conetl.geometry.linear_reference import directions_at, locate
from conetl.geometry.packing import cov3, vec3
from conetl.geometry.small_arrays import robust_std
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.drive import Drive, FramePair
from conetl.model.feature_classes import LANE_MARKING
from conetl.model.markings import Marking, MarkingColour, MarkingTrack, marking_existence
from conetl.model.params import MarkingParams
from conetl.perception.markings.points import MarkingPoints
from conetl.tracking.error_propagation import PoseCov, constant_and_change, moved_by_poses, moved_cov, shared_by_drives
from conetl.tracking.markings.chains import chains_of
from conetl.tracking.markings.located import LocatedPoints, locate_points
from conetl.tracking.markings.patterns import PatternPiece, pieces_of, searched_rows

#: Huber's bound, in sigmas, and rounds of the robust fit.
_ROBUST, _ROUNDS = 2.0, 4
#: A course is fitted to this many points at least.
_LEAST_POINTS = 6
#: Weights of the squared bend (m per vertex) of a course, and of its change, against that of one point: the bend alone would
#: straighten the ends of curves. Chosen on twelve rendered drives.
_BEND, _CHANGE = 0.9, 3.0
#: Sigmas of what all points of one frame pair have in common (glare, shadows, the motion during exposure), and of what all points
#: of a marking have (shape of its edges, disparities).
_FRAME_SIGMA_PX, _COMMON_SIGMA_PX = 0.05, 0.012
#: Sigma across a marking of its worn edges, as a share of the scatter of its width.
_WORN_SHARE = 0.15
#: The bend of a course is the mean of those at this many vertices; sigma of what it adds, as a share of that.
_BEND_VERTICES, _LOST_SHARE = 5, 1.0
#: Share of the variance of the points about the course that vertices show beside the errors above. Most likely, as the share of
#: worn edges, on twelve rendered drives, where vertices were taken as independent.
_NOISE_SHARE = 0.8
#: Vertices whose errors are followed together: the square of their number is kept. 250 m, of which a frame pair shows 13 m.
_STRETCH = 100
#: Frame pairs of less weight than this share of the largest do not move a vertex.
_LEAST_SHARE = 0.02
#: Largest scatter of the points about the course (m) and of the widths (share).
_MAX_SCATTER_M, _MAX_WIDTH_SCATTER = 0.08, 0.35
#: Least share of hits on paint: for solid lines, and for dashes, which have gaps.
_MIN_HITS = {"solid": 0.3, "dashed": 0.15}
_FAR_PERCENT = 67.0
#: Systematic error of a width: blurred edges of paint have no exact position.
_WIDTH_SIGMA_M = 0.006
#: The logarithm of the ratio of paint to road, in blue or red less that in green, of white paint is within this, of yellow paint
#: below that in blue.
_WHITE, _YELLOW = 0.2, -0.25
#: A point this high above the road beside it is not paint: bands of cones, cars.
_MAX_ABOVE_M = 0.12


class _Course(NamedTuple):
    """Fitted course: K vertices."""

    station_m: Floats
    """(K,) along the drive's path; so the following across it, positive to its left, and in the map's height."""
    offset_m: Floats
    height_m: Floats
    frames: Ints
    """(F,) numbers of the frame pairs that observed it."""
    shares: Floats
    """(2, K, F) weight of each of them in the offset and in the height of each vertex; sums over frame pairs are 1."""
    noise_m2: Floats
    """(K, 2, K, 2) covariance of offsets and heights from the scatter of the points, and from bends that the penalty
    straightened."""
    by_paint: Floats
    """(K, K) derivative of the offsets by those of the paint at the vertices: the fit smooths them and fills gaps."""
    kept: Bools
    """(N,) the points that are not outliers."""


def fuse_markings(
    found: Sequence[MarkingPoints], drive: Drive, params: MarkingParams, poses: PoseCov
) -> list[MarkingTrack]:
    """All lane markings of a drive with its final poses and rig. poses: the covariance of these poses."""
    points = locate_points(found, drive, params.max_range_m)
    if points is None:
        return []
    above = np.fmax(points.columns.above_left_m, points.columns.above_right_m)
    points = points.some(~(above > _MAX_ABOVE_M))
    if not len(points.frame):
        return []
    pairs = {pair.frame_index: pair for pair in drive.frame_pairs}
    tracks: list[MarkingTrack] = []
    for chain in chains_of(points, params.max_gap_m):
        own = points.some(chain)
        if not _is_flat(own, params) or len(np.unique(own.frame)) < params.min_frames:
            continue
        rough = _fit_course(own, float(own.road_station_m[0]), float(own.road_station_m[-1]), params.vertex_spacing_m)
        if rough is None:
            continue
        own = own.some(rough.kept)
        searched = searched_rows(own, rough.station_m, rough.offset_m, rough.height_m, drive.rig)
        for piece in pieces_of(searched, params.min_length_m):
            track = _track(len(tracks), own, piece, drive, pairs, params, poses)
            if track is not None:
                tracks.append(track)
    return tracks


def _is_flat(points: LocatedPoints, params: MarkingParams) -> bool:
    """Whether the road on both sides is about as high as the marking, or higher; False unless it was measured on both."""
    for above in (points.columns.above_left_m, points.columns.above_right_m):
        known = above[np.isfinite(above)]
        if len(known) < 0.1 * len(above) or np.median(known) > params.max_above_road_m:
            return False
    return True


def _fit_course(points: LocatedPoints, start_m: float, end_m: float, spacing_m: float) -> _Course | None:
    """Course of the points of one marking between two stations; None where it is too short or they are too few."""
    # Stations of the stereo points have errors of their depth: those at the end of a course would be the ones too far away.
    inside = (points.road_station_m >= start_m - spacing_m / 2) & (points.road_station_m <= end_m + spacing_m / 2)
    count = max(round((end_m - start_m) / spacing_m), 1) + 1
    if inside.sum() < _LEAST_POINTS or end_m - start_m < spacing_m:
        return None
    knots = np.linspace(start_m, end_m, count)
    position = np.clip((points.road_station_m[inside] - start_m) / (knots[1] - knots[0]), 0, count - 1 - 1e-9)
    first = position.astype(np.intp)
    part = position - first
    hats = np.zeros((len(first), count))
    hats[np.arange(len(first)), first], hats[np.arange(len(first)), first + 1] = 1 - part, part
    observed = np.stack([points.offset_m[inside], points.xyz_m[inside, 2]], axis=1)
    prior = points.weight[inside] / np.median(points.weight[inside], axis=0)
    bend = np.diff(np.eye(count), n=2, axis=0)
    change = np.diff(bend, axis=0)
    penalty = _BEND * bend.T @ bend + _CHANGE * change.T @ change + 1e-9 * np.eye(count)
    robust = np.ones(len(first))
    for _ in range(_ROUNDS):
        weight = (prior * robust[:, None]).T
        normal = np.stack([hats.T @ (hats * of[:, None]) for of in weight]) + penalty
        inverse = np.linalg.inv(normal)
        course = np.stack(
            [one @ (hats.T @ (of * y)) for one, of, y in zip(inverse, weight, observed.T, strict=True)], axis=1
        )
        scaled = (observed - hats @ course) * np.sqrt(prior)
        sigma = np.maximum(1.4826 * np.median(np.abs(scaled), axis=0), 1e-4)
        size = np.sqrt((scaled**2 / sigma**2).mean(axis=1))
        robust = np.minimum(1.0, _ROBUST / np.maximum(size, 1e-9))
    frames, number = np.unique(points.frame[inside], return_inverse=True)
    by_frame = np.zeros((2, len(frames), count))
    for of, sums in zip(weight, by_frame, strict=True):
        np.add.at(sums, number, hats * of[:, None])
    shares = inverse @ by_frame.swapaxes(1, 2)
    shares /= shares.sum(axis=2, keepdims=True)
    core, both = size < 3 * _ROBUST, np.sqrt(weight.prod(axis=0))
    scatter = (scaled[core].T * both[core]) @ scaled[core] / both[core].sum() if core.any() else np.eye(2)
    mixed, (across, up) = hats.T @ (hats * both[:, None]), normal - penalty
    spread = np.einsum("cij,cdjk,dkl->icld", inverse, np.array([[across, mixed], [mixed, up]]), inverse, optimize=True)
    noise = _NOISE_SHARE * spread * scatter[:, None, :]
    if len(bend):
        # Vertices of a polyline through the points of a curve are a twelfth of its bend inside of it, and the penalty straightens
        # the ends: by so much of a parabola that bends as the course does near by.
        near_by = uniform_filter1d(np.pad(bend @ course[:, 0], 1, mode="edge"), _BEND_VERTICES, mode="nearest")
        lost = (1 / 12 + inverse[0] @ penalty @ (np.arange(count) ** 2 / 2)) * near_by
        course[:, 0] += lost
        # Errors of means of bends are correlated as far as these have bends in common.
        apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
        noise[:, 0, :, 0] += _LOST_SHARE**2 * np.outer(lost, lost) * np.maximum(1 - apart / _BEND_VERTICES, 0.0)
    kept = np.zeros(len(points.station_m), dtype=bool)
    kept[np.flatnonzero(inside)[core]] = True
    return _Course(knots, course[:, 0], course[:, 1], frames, shares, noise, inverse[0] @ across, kept)


def _track(
    index: int,
    points: LocatedPoints,
    piece: PatternPiece,
    drive: Drive,
    pairs: dict[int, FramePair],
    params: MarkingParams,
    poses: PoseCov,
) -> MarkingTrack | None:
    course = _fit_course(points, piece.start_m, piece.end_m, params.vertex_spacing_m)
    if course is None or piece.hit_share < _MIN_HITS[piece.pattern]:
        return None
    own = points.some(course.kept)
    frames = np.unique(own.frame)
    if len(frames) < params.min_frames or not _is_flat(own, params):
        return None
    residual = own.road_offset_m - np.interp(own.road_station_m, course.station_m, course.offset_m)
    direction = directions_at(points.line_m, own.station_m)
    slope = np.interp(own.station_m, course.station_m, np.gradient(course.offset_m, course.station_m))
    heading = direction + slope[:, None] * np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    aside = points.map_SE3_left[own.frame][:, :2, 0]
    # Rows of the image cross a marking at an angle.
    widths = own.columns.width_m * np.abs(heading[:, 1] * aside[:, 0] - heading[:, 0] * aside[:, 1])
    # Blur widens them with the distance: the nearest third counts.
    depth = own.columns.road_px
    widths = widths[depth >= np.percentile(depth, _FAR_PERCENT)]
    width = float(np.median(widths))
    width_scatter = robust_std(widths)
    if robust_std(residual) > _MAX_SCATTER_M or width_scatter > _MAX_WIDTH_SCATTER * width:
        return None
    xyz = np.column_stack([locate(points.line_m, course.station_m, course.offset_m), course.height_m])
    joint, pose_part, calibrated, common = _covariances(
        points, course, xyz, _WORN_SHARE * width_scatter, drive, pairs, poses
    )
    own_cov = np.concatenate([np.einsum("kikj->kij", stretch) for stretch in joint])
    middle = len(xyz) // 2
    contrast = float(np.median(own.columns.contrast))
    seen = [pairs[points.frames[number].frame_index].captured_at_ns for number in frames]
    absolute = own_cov + pose_part[0] + shared_cov(calibrated, drive.rig)
    return MarkingTrack(
        marking_index=index,
        category=LANE_MARKING,
        marking=Marking(
            vertices_m=tuple(map(vec3, xyz)),
            cov_m2=tuple(map(cov3, absolute)),
            width_m=width,
            width_sigma_m=float(np.hypot(width_scatter / np.sqrt(len(frames)), _WIDTH_SIGMA_M)),
            colour=_colour(own),
            pattern=piece.pattern,
            dash_m=piece.dash_m,
            gap_m=piece.gap_m,
        ),
        relative_cov_m2=tuple(map(cov3, own_cov + pose_part[1])),
        image_cov_m2=tuple(stretch.tobytes() for stretch in joint),
        existence_probability=marking_existence(len(frames), contrast, piece.hit_share),
        observation_count=len(frames),
        first_seen_ns=min(seen),
        last_seen_ns=max(seen),
        contrast=contrast,
        blur_px=max(float(np.median(own.columns.blur_px2)), 0.0) ** 0.5,
        shared_jacobian=jacobian_of(calibrated[middle], drive.rig, common[middle]),
    )


def _covariances(
    points: LocatedPoints,
    course: _Course,
    xyz: Floats,
    worn_m: float,
    drive: Drive,
    pairs: dict[int, FramePair],
    poses: PoseCov,
) -> tuple[list[Floats], tuple[Floats, Floats], Floats, list[list[tuple[UUID, Floats]]]]:
    """Of K vertices: joint covariances (k, 3, k, 3) m^2 from the images, stretch by stretch; (K, 3, 3) from all errors of the
    poses, and from the part of them that the frame pairs do not share; (K, 3, C) derivatives by the calibration's parameters; ids
    and Jacobians of errors of the poses that drives share."""
    rig, count = drive.rig, len(xyz)
    direction = directions_at(points.line_m, course.station_m)
    across = np.stack([-direction[:, 1], direction[:, 0], np.zeros(count)], axis=1)
    axes = np.stack([across, np.broadcast_to([0.0, 0.0, 1.0], across.shape)], axis=2)
    whole, change = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
    calibrated, common, by_images = [], [], []
    for k, vertex in enumerate(xyz):
        largest = np.abs(course.shares[:, k]).max(axis=0)
        used = largest > _LEAST_SHARE * largest.max()
        frames, (aside, above) = course.frames[used], course.shares[:, k, used]
        aligned = np.outer(across[k], across[k])
        # Errors across the marking move the offset, all others the height.
        shares = np.multiply.outer(aside / aside.sum(), aligned) + np.multiply.outer(
            above / above.sum(), np.eye(3) - aligned
        )
        left = points.map_SE3_left[frames]
        seen = np.einsum("fji,fj->fi", left[:, :3, :3], vertex - left[:, :3, 3])
        seen[:, 2] = np.maximum(seen[:, 2], 1.0)
        moved_by_images = _by_images(left, seen, shares, axes[k], rig.left.fx_px, rig.left.fx_px * rig.baseline_m)
        by_images.append((frames, moved_by_images))
        members = [pairs[points.frames[number].frame_index] for number in frames]
        moved = shares @ moved_by_poses(np.broadcast_to(vertex, seen.shape), [one.pose for one in members])
        cov = poses([one.frame_index for one in members])
        rank = np.arange(len(members))
        for target, part in ((whole, cov), (change, constant_and_change(cov)[1])):
            target[k] = moved_cov(moved, rank, part).reshape(len(rank), 3, len(rank), 3).sum(axis=(0, 2))
        shared, lacking = shared_by_drives(
            drive.common_errors, shares, [one.pose for one in members], whole[k], corrected=bool(drive.control_points)
        )
        whole[k] += lacking
        common.append(shared)
        by_calibration = left[:, :3, :3] @ calibration_jacobian(seen, rig)
        calibrated.append((shares @ by_calibration).sum(axis=0))
    stretches = [slice(first, first + _STRETCH) for first in range(0, count, _STRETCH)]
    joint = [_joint_cov(course, axes, worn_m, by_images, stretch) for stretch in stretches]
    return joint, (whole, change), np.stack(calibrated), common


def _by_images(left: Floats, seen: Floats, shares: Floats, axes: Floats, focal_px: float, focal_base: float) -> Floats:
    """(F, 3, 2) m per px, across the marking and in height: derivatives of a vertex by the errors of column and disparity that
    its points of each frame pair share. seen, shares: (F, 3) and (F, 3, 3) of the vertex, by frame pair."""
    by_column = seen[:, 2:] / focal_px * np.array([1.0, 0.0, 0.0])
    by_disparity = -seen * seen[:, 2:] / focal_base
    return np.asarray(axes @ axes.T @ shares @ left[:, :3, :3] @ np.stack([by_column, by_disparity], axis=2))


def _joint_cov(
    course: _Course, axes: Floats, worn_m: float, by_images: Sequence[tuple[Ints, Floats]], stretch: slice
) -> Floats:
    """(k, 3, k, 3) m^2 of the vertices of a stretch, by all errors in the images.

    Neighbouring vertices have most of them in common: the frame pairs, the marking, and points that the penalty ties to both.
    Worn edges are errors of the paint, the same in all images: the fit smooths them as it smooths the paint's own course, so that
    they do not make vertices zigzag, least of all in gaps, where there is no paint.
    """
    noise = course.noise_m2[stretch][:, :, stretch].copy()
    noise[:, 0, :, 0] += worn_m**2 * course.by_paint[stretch] @ course.by_paint[stretch].T
    axes, own = axes[stretch], by_images[stretch]
    first = min(int(frames.min()) for frames, _ in own)
    by_frame = np.zeros((len(own), 3, max(int(frames.max()) for frames, _ in own) - first + 1, 2))
    for k, (frames, moved) in enumerate(own):
        by_frame[k, :, frames - first] = moved
    shared = by_frame.reshape(3 * len(own), -1), by_frame.sum(axis=2).reshape(3 * len(own), -1)
    of_frames, of_all = (
        sigma**2 * part @ part.T for sigma, part in zip((_FRAME_SIGMA_PX, _COMMON_SIGMA_PX), shared, strict=True)
    )
    turned = np.einsum("kia,kalb,ljb->kilj", axes, noise, axes, optimize=True)
    return np.asarray(turned + (of_frames + of_all).reshape(turned.shape))


def _colour(points: LocatedPoints) -> MarkingColour:
    blue, red = (float(np.median(tint)) for tint in (points.columns.blue, points.columns.red))
    if blue < _YELLOW and red > blue:
        return "yellow"
    return "white" if abs(blue) <= _WHITE and abs(red) <= _WHITE else "other"
