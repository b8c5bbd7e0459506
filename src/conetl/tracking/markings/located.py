"""Points of lane markings of a whole drive: in the map, and along and across the drive's path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from conetl.geometry.camera import intrinsics, rays
from conetl.geometry.linear_reference import project, smoothed, spaced, stations
from conetl.geometry.motion.rolling_shutter import at_stamp, camera_rates, readouts_s, row_shares
from conetl.geometry.motion.stereo_motion import StereoCameras
from conetl.geometry.rig import map_SE3_left
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.drive import Drive
from conetl.model.rig import Rig
from conetl.perception.markings.points import MarkingPoints, PointColumns

#: Spacing and smoothing of the path's points: a vehicle sways within its lane. Points nearer than this to the one
#: before are left out.
_PATH_STEP_M, _PATH_SIGMA_M, _LEAST_MOVE_M = 1.0, 3.0, 0.3
#: Variance of disparities by the square of how far aside a point is, in camera heights; variance of offsets straight ahead, as a
#: share of that of heights. Scatter of the points of twelve lines on rendered drives about their true course.
_OBLIQUE, _COLUMNS = 0.25, 0.25
#: Length of the end of a path by which it is continued.
_BEND_M = 10.0
#: A point is this far behind and ahead of its camera along the path; a path may return to the same road.
_BEHIND_M, _AHEAD_M = 5.0, 15.0


@dataclass(frozen=True)
class LocatedPoints:
    """N points of all frame pairs of a drive, and the path that their stations belong to."""

    line_m: Floats
    """(P, 2) easting and northing of the path of the left camera."""
    frames: tuple[MarkingPoints, ...]
    """The F frame pairs that were searched, ..."""
    frame_station_m: Floats
    """... (F,) where they are on the path, ..."""
    map_SE3_left: Floats
    """... and (F, 4, 4) their left cameras."""
    frame: Ints
    """(N,) number of the frame pair of each point."""
    columns: PointColumns
    xyz_m: Floats
    """(N, 3) in the map, by intersection of the rays of both images."""
    station_m: Floats
    offset_m: Floats
    """(N,) of these points from the path, positive to its left."""
    road_station_m: Floats
    road_offset_m: Floats
    """(N,) of where the left ray meets the plane of the road: less noise, but wrong where the road is not a plane."""
    weight: Floats
    """(N, 2) inverse variances of offsets and of heights, up to a common factor."""

    def some(self, chosen: Ints | Bools) -> LocatedPoints:
        """Those points only."""
        return LocatedPoints(
            self.line_m, self.frames, self.frame_station_m, self.map_SE3_left, self.frame[chosen],
            PointColumns(*(column[chosen] for column in self.columns)), self.xyz_m[chosen], self.station_m[chosen],
            self.offset_m[chosen], self.road_station_m[chosen], self.road_offset_m[chosen], self.weight[chosen],
        )  # fmt: skip


def camera_points(columns: PointColumns, disparity_px: Floats, rig: Rig) -> Floats:
    """(N, 3) m, in the left camera's frame, at disparities (N,)."""
    depth = rig.left.fx_px * rig.baseline_m / disparity_px
    return rays(rig.left, np.stack([columns.u_px, columns.v_px], axis=1)) * depth[:, None]


def _at_stamp(frames: Sequence[MarkingPoints], drive: Drive) -> list[PointColumns]:
    """The points of each frame pair, with image points and disparities as of a global shutter at the time stamp."""
    columns, rig = [one.columns() for one in frames], drive.rig
    if not readouts_s(rig).any():
        return columns
    rank = {pair.frame_index: k for k, pair in enumerate(drive.frame_pairs)}
    rates = camera_rates(drive.frame_pairs, rig)
    # Disparities are against a right camera turned like the left one.
    apart = np.eye(4)
    apart[0, 3] = -rig.baseline_m
    cameras = StereoCameras(intrinsics(rig.left), intrinsics(rig.left), apart)
    moved = []
    for one, own in zip(frames, columns, strict=True):
        shares = row_shares(rig, "left", np.stack([own.u_px, own.v_px], axis=1))
        times_s = shares[:, None] * readouts_s(rig)  # the rows of both images are equal
        by_stereo, by_road = (
            at_stamp(
                cameras, np.stack([own.u_px, own.v_px, own.u_px - disparity, own.v_px], axis=1), times_s,
                rates[rank[one.frame_index]],
            )
            for disparity in (own.disparity_px, own.road_px)
        )  # fmt: skip
        moved.append(
            own._replace(
                u_px=by_stereo[:, 0], v_px=by_stereo[:, 1], disparity_px=by_stereo[:, 0] - by_stereo[:, 2],
                road_px=by_road[:, 0] - by_road[:, 2],
            )
        )  # fmt: skip
    return moved


def _extended(line: Floats, length_m: float) -> Floats:
    """The line (P, 2) and as much more in the bend of its last `_BEND_M`: cameras see farther than the drive goes."""
    steps = np.diff(line, axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    step = float(np.hypot(*steps[-1]))
    count = min(int(_BEND_M / step), len(heading) - 1)
    turn = (heading[-1] - heading[-1 - count]) / count if count > 0 else 0.0
    ahead = heading[-1] + turn * np.arange(1, int(length_m / step) + 2)
    added = line[-1] + step * np.cumsum(np.stack([np.cos(ahead), np.sin(ahead)], axis=1), axis=0)
    return np.concatenate([line, added])


def locate_points(found: Sequence[MarkingPoints], drive: Drive, max_range_m: float) -> LocatedPoints | None:
    """All points of a drive, with the drive's poses and rig; None for a drive that shows none or does not move."""
    poses: Mapping[int, Floats] = {pair.frame_index: map_SE3_left(pair.pose, drive.rig) for pair in drive.frame_pairs}
    path = np.stack([pose[:2, 3] for pose in poses.values()])
    moved = path[spaced(path, _LEAST_MOVE_M)]
    frames = tuple(one for one in found if one.frame_index in poses and one.points)
    if len(moved) < 2 or not frames:
        return None
    driven_line = smoothed(moved, _PATH_STEP_M, _PATH_SIGMA_M)
    line = _extended(driven_line, max_range_m)
    left = np.stack([poses[one.frame_index] for one in frames])
    along = stations(line)
    # A path may cross itself: the station of a frame pair is found by how far the vehicle had come.
    driven = dict(zip(poses, stations(path), strict=True))
    share = along[len(driven_line) - 1] / max(*driven.values(), 1e-9)
    guess = [share * driven[one.frame_index] for one in frames]
    columns = _at_stamp(frames, drive)
    xyz, places, own_station = [], [], []
    for pose, own, near in zip(left, columns, guess, strict=True):
        first, last = np.searchsorted(along, [near - _BEHIND_M, near + max_range_m + _AHEAD_M])
        first = min(max(first - 1, 0), len(line) - 2)
        part = line[first : max(last + 1, first + 2)]
        by_stereo, by_road = (
            camera_points(own, disparity, drive.rig) @ pose[:3, :3].T + pose[:3, 3]
            for disparity in (own.disparity_px, own.road_px)
        )
        s, d = project(part, np.concatenate([pose[None, :2, 3], by_stereo[:, :2], by_road[:, :2]]))
        xyz.append(by_stereo)
        own_station.append(s[0] + along[first])
        places.append(np.concatenate([s[1:] + along[first], d[1:]]).reshape(4, -1))
    together = PointColumns(*(np.concatenate(parts) for parts in zip(*columns, strict=True)))
    station, road_station, offset, road_offset = np.concatenate(places, axis=1)
    camera = camera_points(together, together.road_px, drive.rig)
    # Errors of disparities grow where a marking crosses the rows at a flat angle, their effect with the distance. They move a
    # point along its ray: the farther aside, the more across the road; where rays are level with it, only columns count.
    below_m = np.maximum(camera[:, 1], 0.3)
    by_disparity = 1 + _OBLIQUE * (camera[:, 0] / below_m) ** 2
    across = _COLUMNS + ((camera[:, 0] - drive.rig.baseline_m / 2) / below_m) ** 2 * by_disparity
    return LocatedPoints(
        line, frames, np.array(own_station), left, np.repeat(np.arange(len(frames)), [len(own.u_px) for own in columns]),
        together, np.concatenate(xyz), station, offset, road_station, road_offset,
        1 / (camera[:, 2:] ** 2 * np.stack([across, by_disparity], axis=1)),
    )  # fmt: skip
