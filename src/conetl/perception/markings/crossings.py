"""Lane markings in one frame pair: where rows of both images cross bright bands on the road.

Both images are resampled to one grid on the road plane (`road_plane.py`): a row of the grid is a row of the left image, its
columns are `_STEP_M` apart on the road. A band is a rising and a falling edge (extremes of the derivative of a Gaussian, to a
part of a column) as far apart as paint is wide, brighter than the road on both sides of it, which are alike unless a shadow ends
there. Bands of the same row in both images are one point in space, whatever the shape of the road. Kerbs are bright bands too:
the road beside paint is as high as the paint, which the dense disparities show.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from conetl.geometry.rig import infinity_homography
from conetl.geometry.small_arrays import nearest_index
from conetl.model.arrays import Floats, Image, Ints
from conetl.model.params import MarkingParams
from conetl.model.rig import Rig
from conetl.perception.markings.points import MarkingPoints, PointColumns
from conetl.perception.markings.road_plane import RoadPlane, find_road

Grid = NDArray[np.float32]

#: Columns of the grid on the road: fine enough for the nearest rows, of which a pixel is about as wide.
_STEP_M = 0.01
#: Weights of blue, green and red in the grey levels.
_RED_AND_GREEN = np.array([[0.0, 0.5, 0.5]], dtype=np.float32)
#: Rows of the grid are at least this far apart along the road.
_ROW_STEP_M = 0.2
#: Sigma of the Gaussian whose derivative finds edges.
_EDGE_SIGMA_M = 0.02
#: The road beside a band: from and to this distance from its edges.
_BESIDE_M = (0.04, 0.14)
#: Inside of a band: at least this far from its edges.
_INSIDE_M = 0.02
#: Where their mean grey levels are sampled, as shares of the width.
_SAMPLES = np.linspace(0.0, 1.0, 9)
#: A band's edges and its middle are at least this many sigmas of the row's noise above the road ...
_NOISE_SIGMAS = 4.0
#: ... and this share of the road's grey level; the two sides differ by at most this share of the contrast.
_LEAST_RELATIVE, _SIDE_SHARE = 0.25, 0.5
#: Where they differ more, as along the edge of a shadow, it is brighter than the brighter one by at least this share of that one.
_LEAST_AT_SHADOW = 0.35
#: Bands of both images are one marking if they are this near on the road plane (it may lie 0.3 m higher or lower) ...
_PARALLAX_M = 0.15
#: ... and their widths and contrasts have at most these ratios.
_WIDTH_RATIO, _CONTRAST_RATIO = 1.4, 1.6
#: Where the height of the road beside a marking is measured: distances from its edges (m), and rows of the image.
_ROAD_BESIDE_M = np.linspace(0.2, 0.6, 9)
_ROAD_ROWS_PX = np.array([-4.0, 0.0, 4.0])
_LEAST_ON_SIDE = 4


class _RoadGrid(NamedTuple):
    """Image points of the grid's R rows and C columns on the road plane."""

    rows_px: Floats
    """(R,) rows of the left image."""
    depth_m: Floats
    """(R,) of the middle column."""
    columns_px: Floats
    """(R,) pixels between two columns."""
    offsets: Floats
    """(C,) columns from the middle one."""
    plane: Floats
    """(3,) as `RoadPlane.plane`"""

    def u_px(self, row: Ints, column: Floats, cx_px: float) -> Floats:
        """(N,) columns of the left image at rows and (fractional) columns of the grid (N,)."""
        return np.asarray(cx_px + (column + self.offsets[0]) * self.columns_px[row])

    def road_px(self, row: Ints, u_px: Floats) -> Floats:
        """(N,) disparities of the road at columns of the left image in rows of the grid (N,)."""
        return np.asarray(self.plane[0] * u_px + self.plane[1] * self.rows_px[row] + self.plane[2])


class _Bands(NamedTuple):
    """N bright bands in one resampled image."""

    row: Ints
    """(N,) of the grid"""
    rise: Floats
    """(N,) fractional column of the left edge ..."""
    fall: Floats
    """... and of the right one"""
    contrast: Floats
    """(N,) grey levels above the mean of both sides"""
    blur: Floats
    """(N,) variance of the blur of its edges, in squares of columns (`PointColumns.blur_px2`)"""

    @property
    def middle(self) -> Floats:
        return (self.rise + self.fall) / 2


def find_points(frame_index: int, left: Image, right: Image, rig: Rig, params: MarkingParams) -> MarkingPoints:
    """All points of lane markings that one frame pair of colour images (H, W, 3) shows; none where it shows no road."""
    grey_left, grey_right = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right))
    road = find_road(grey_left, grey_right, rig)
    if road is None:
        return MarkingPoints(frame_index=frame_index)
    grid = _road_grid(road, rig, params)
    if not len(grid.rows_px):
        return MarkingPoints(frame_index=frame_index)
    cx = rig.left.cx_px
    rows, offsets = grid.rows_px[:, None].astype(np.float32), grid.offsets.astype(np.float32)
    u = np.float32(cx) + offsets * grid.columns_px[:, None].astype(np.float32)
    by_u, by_v, constant = road.plane.astype(np.float32)
    parallel = u * (1 - by_u) - (rows * by_v + constant)
    turn = infinity_homography(rig).astype(np.float32)
    ahead = turn[2, 0] * parallel + (turn[2, 1] * rows + turn[2, 2])
    u_right, v_right = ((one[0] * parallel + (one[1] * rows + one[2])) / ahead for one in turn[:2])
    sides = [_resampled(left, u, np.broadcast_to(rows, u.shape)), _resampled(right, u_right, v_right)]
    ours, theirs = (_find_bands(grey, params) for _, grey in sides)
    first, second = _matched(ours, theirs)
    row, rise, fall = ours.row[first], ours.rise[first], ours.fall[first]
    u_left = grid.u_px(row, (rise + fall) / 2, cx)
    u_right = grid.u_px(row, theirs.middle[second], cx)
    disparity = u_left - u_right + grid.road_px(row, u_right)
    uv = np.stack([u_left, grid.rows_px[row]], axis=1)
    height, focal_base = road.height_m(uv, disparity), rig.left.fx_px * rig.baseline_m
    width = (fall - rise + theirs.fall[second] - theirs.rise[second]) / 2 * _STEP_M
    blue, red = _log_colour_ratios(sides[0][0], ours, first)
    found = PointColumns(
        u_px=u_left,
        v_px=uv[:, 1],
        disparity_px=disparity,
        width_m=width * focal_base / (grid.depth_m[row] * disparity),
        contrast=(ours.contrast[first] + theirs.contrast[second]) / 2,
        blue=blue,
        red=red,
        above_left_m=height - _road_height_beside(road, grid, row, grid.u_px(row, rise, cx), -1),
        above_right_m=height - _road_height_beside(road, grid, row, grid.u_px(row, fall, cx), 1),
        road_px=grid.road_px(row, u_left),
        row=row.astype(np.float64),
        blur_px2=ours.blur[first] * grid.columns_px[row] ** 2,
    )
    return MarkingPoints(
        frame_index=frame_index,
        points=np.stack(found, axis=1),
        rows=np.stack([grid.rows_px, grid.depth_m], axis=1),
    )


def _road_grid(road: RoadPlane, rig: Rig, params: MarkingParams) -> _RoadGrid:
    """Rows about `_ROW_STEP_M` apart between the least and the largest range that lie in the image; columns as far as params say.

    Whole rows of the image: interpolated between two rows, an edge that crosses them at a flat angle has two steps.
    """
    camera, plane = rig.left, road.plane
    depth = np.arange(params.min_range_m, params.max_range_m, _ROW_STEP_M)
    focal_base, by_row = camera.fx_px * rig.baseline_m, np.array([plane[1], plane[2] + plane[0] * camera.cx_px])
    rows = np.unique(np.rint((focal_base / depth - by_row[1]) / by_row[0]))[::-1]
    rows = rows[(rows >= 0) & (rows <= camera.height_px - 1)]
    depth = focal_base / (rows * by_row[0] + by_row[1])
    half = int(params.max_offset_m / _STEP_M)
    return _RoadGrid(rows, depth, _STEP_M * camera.fx_px / depth, np.arange(-half, half + 1.0), plane)


def _resampled(image: Image, u: Grid, v: Grid) -> tuple[Image, Grid]:
    """The colours (R, C, 3) and grey levels (R, C) of an image at points; NaN in the grey levels outside of it.

    Grey levels are means of red and green: in blue, yellow paint is no brighter than the road.
    """
    colours = np.asarray(cv2.remap(image, u, np.ascontiguousarray(v), cv2.INTER_LINEAR), dtype=np.uint8)
    grey = np.asarray(cv2.transform(colours.astype(np.float32), _RED_AND_GREEN), dtype=np.float32)
    height, width = image.shape[:2]
    grey[(u < 0) | (u > width - 1) | (v < 0) | (v > height - 1)] = np.nan
    return colours, grey


def _find_bands(grey: Grid, params: MarkingParams) -> _Bands:
    """Bands in a resampled image (R, C), NaN where there is none."""
    valid = np.isfinite(grey)
    sigma = _EDGE_SIGMA_M / _STEP_M
    slope = _derivative(np.where(valid, grey, 0.0).astype(np.float32), sigma)
    reach = int(np.ceil(3 * sigma)) + 1
    inner = cv2.erode(valid.astype(np.uint8), np.ones((1, 2 * reach + 1), np.uint8), borderValue=0) > 0
    slope *= inner
    # A step of height 1 has this peak.
    peak = 1 / (sigma * np.sqrt(2 * np.pi))
    # The median of the usable ones: where they are not, infinity is sorted behind them.
    spread = np.sort(np.where(inner[:, ::8], np.abs(slope[:, ::8]), np.inf), axis=1)
    middle = np.isfinite(spread).sum(axis=1) // 2
    typical = spread[np.arange(len(spread)), middle]
    noise = 1.4826 * np.where(np.isfinite(typical), typical, 0.0) / peak
    least = (np.maximum(params.min_contrast / 2, _NOISE_SIGMAS / 2 * noise)[:, None] * peak).astype(np.float32)
    rise_row, rise = _peaks(slope, least)
    fall_row, fall = _peaks(-slope, least)
    columns = grey.shape[1]
    rise_key, fall_key = rise_row * columns + rise, fall_row * columns + fall
    after = np.searchsorted(fall_key, rise_key)
    # The last rising edge before a falling one.
    last = np.append(after[1:] != after[:-1], True) if len(after) else np.zeros(0, dtype=bool)
    usable = last & (after < len(fall_key))
    rise_row, rise, after = rise_row[usable], rise[usable], after[usable]
    width = (fall[after] - rise) * _STEP_M
    fits = (fall_row[after] == rise_row) & (width >= params.min_width_m) & (width <= params.max_width_m)
    row, rise, fall = rise_row[fits], rise[fits], fall[after[fits]]
    inside, before, behind = _inside_and_beside(grey, row, rise, fall)
    contrast = inside - (before + behind) / 2
    darkest = np.maximum(before, behind)
    good = inside - darkest >= np.maximum(params.min_contrast, _NOISE_SIGMAS * noise[row])
    alike = np.abs(before - behind) <= _SIDE_SHARE * contrast
    good &= (contrast >= _LEAST_RELATIVE * darkest) & (alike | (inside - darkest >= _LEAST_AT_SHADOW * darkest))
    row, rise, fall, inside = row[good], rise[good], fall[good], inside[good]
    # The steeper edge: the slope of a blurred step of this height, less the part of the derivative's own Gaussian.
    steps = np.stack([inside - before[good], inside - behind[good]])
    steep = np.stack([slope[row, np.rint(rise).astype(np.intp)], -slope[row, np.rint(fall).astype(np.intp)]])
    blur = (steps / (steep * np.sqrt(2 * np.pi))) ** 2 - sigma**2
    return _Bands(row, rise, fall, contrast[good], blur.min(axis=0))


def _derivative(grey: Grid, sigma: float) -> Grid:
    """Along the rows, of the image smoothed by a Gaussian."""
    at = np.arange(-int(np.ceil(3 * sigma)), int(np.ceil(3 * sigma)) + 1)
    kernel = np.exp(-0.5 * (at / sigma) ** 2) / (sigma**3 * np.sqrt(2 * np.pi)) * at
    return np.asarray(cv2.filter2D(grey, cv2.CV_32F, kernel[None].astype(np.float32)))


def _peaks(slope: Grid, least: Grid) -> tuple[Ints, Floats]:
    """Rows and fractional columns of the maxima along rows that reach `least` (R, 1), in order."""
    high = slope[:, 1:-1] >= least
    # One row after the other: numpy finds set elements of a mask much faster in one dimension than in two.
    row, column = np.divmod(np.flatnonzero(high), max(high.shape[1], 1))
    a, b, c = (slope[row, column + k].astype(np.float64) for k in range(3))
    highest = (b >= a) & (b > c)
    row, column = row[highest], column[highest]
    a, b, c = a[highest], b[highest], c[highest]
    return row, column + 1 + 0.5 * (a - c) / (a - 2 * b + c)


def _inside_and_beside(
    image: NDArray[np.generic], row: Ints, rise: Floats, fall: Floats
) -> tuple[Floats, Floats, Floats]:
    """(N, ...) mean values of a resampled image (R, C, ...) in bands with these edges, and on their left and right."""
    inset, near, far = _INSIDE_M / _STEP_M, _BESIDE_M[0] / _STEP_M, _BESIDE_M[1] / _STEP_M
    parts = ((rise + inset, fall - inset), (rise - far, rise - near), (fall + near, fall + far))

    def mean(start: Floats, end: Floats) -> Floats:
        columns = np.rint(start[:, None] + (end - start)[:, None] * _SAMPLES).astype(np.intp)
        values = image[row[:, None], np.clip(columns, 0, image.shape[1] - 1)]
        return np.asarray(values.mean(axis=1, dtype=np.float64))

    inside, before, behind = (mean(*part) for part in parts)
    return inside, before, behind


def _matched(ours: _Bands, theirs: _Bands) -> tuple[Ints, Ints]:
    """Numbers (M,) of bands of the left and (M,) of the right image that are mutually nearest in a row, and similar."""
    if not len(ours.row) or not len(theirs.row):
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    apart = 1e6
    ours_key, theirs_key = ours.row * apart + ours.middle, theirs.row * apart + theirs.middle
    forth, back = nearest_index(theirs_key, ours_key), nearest_index(ours_key, theirs_key)
    first = np.flatnonzero(back[forth] == np.arange(len(forth)))
    second = forth[first]
    ratio = (ours.fall - ours.rise)[first] / (theirs.fall - theirs.rise)[second]
    contrasts = ours.contrast[first] / theirs.contrast[second]
    good = np.abs(ours_key[first] - theirs_key[second]) * _STEP_M <= _PARALLAX_M
    good &= np.abs(np.log(ratio)) <= np.log(_WIDTH_RATIO)
    good &= np.abs(np.log(contrasts)) <= np.log(_CONTRAST_RATIO)
    return first[good], second[good]


def _road_height_beside(road: RoadPlane, grid: _RoadGrid, row: Ints, edge_px: Floats, sign: int) -> Floats:
    """(N,) median measured height above the plane beside an edge, on its outer side; NaN where too little was measured."""
    if not len(row):
        return np.zeros(0)
    u = edge_px[:, None] + sign * _ROAD_BESIDE_M / _STEP_M * grid.columns_px[row][:, None]
    uv = np.stack(np.broadcast_arrays(u[:, None, :], (grid.rows_px[row][:, None] + _ROAD_ROWS_PX)[:, :, None]), axis=-1)
    heights = road.height_m(uv, road.measured_at(uv)).reshape(len(row), -1)
    ordered, count = np.sort(heights, axis=1), np.isfinite(heights).sum(axis=1)  # unknown ones are last
    lower, upper = (ordered[np.arange(len(row)), middle] for middle in ((count - 1) // 2, count // 2))
    return np.where(count >= _LEAST_ON_SIDE, (lower + upper) / 2, np.nan)


def _log_colour_ratios(colours: Image, bands: _Bands, chosen: Ints) -> tuple[Floats, Floats]:
    """(N,) logarithms of how much brighter than the road the paint is, in blue and in red, each relative to green.

    Ratios of paint to road do not depend on the white balance; for white paint they are equal in all colours.
    """
    paint, before, behind = _inside_and_beside(colours, bands.row[chosen], bands.rise[chosen], bands.fall[chosen])
    blue, green, red = np.log(np.maximum(paint, 1) / np.maximum((before + behind) / 2, 1)).T
    return blue - green, red - green
