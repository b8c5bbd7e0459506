"""Which vertices of lane markings a drive had in view: where it searched for markings, with nothing detected in front."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.linear_reference import spaced
from conetl.mapping.visibility import DriveObservations
from conetl.model.feature_classes import LANE_MARKING
from conetl.model.markings import MarkingTrack
from conetl.model.params import MarkingParams, ReconcileParams

Floats = NDArray[np.float64]
#: Of frame pairs recorded nearer to each other one is searched.
_STEP_M = MarkingParams().pair_spacing_m


class MarkingView(NamedTuple):
    """The frame pairs (K,) that show any of some vertices (n,)."""

    captured_at_ns: NDArray[np.int64]
    in_view: NDArray[np.bool_]
    """(n, K)"""

    def after(self, instant_ns: int) -> MarkingView:
        """The frame pairs that were recorded after an instant."""
        later = self.captured_at_ns > instant_ns
        return MarkingView(self.captured_at_ns[later], self.in_view[:, later])

    def period_of(self, vertices: NDArray[np.bool_]) -> tuple[int, int, int] | None:
        """Number of the frame pairs that show any of the vertices (n,), and the instants of the first and the last; or None."""
        captured_ns = self.captured_at_ns[self.in_view[vertices].any(axis=0)]
        return (len(captured_ns), int(captured_ns.min()), int(captured_ns.max())) if len(captured_ns) else None


def not_in_view(vertices_m: Floats) -> MarkingView:
    """Of a drive that did not search for lane markings."""
    return MarkingView(np.empty(0, np.int64), np.empty((len(vertices_m), 0), bool))


def blur_of(markings: Sequence[MarkingTrack]) -> float:
    """Sigma (px) by which a drive's images blur the edges of its markings, median; 0 without any."""
    return float(np.median([track.blur_px for track in markings])) if markings else 0.0


def markings_in_view(
    vertices_m: Floats, drive: DriveObservations, blur_px: float, params: ReconcileParams
) -> MarkingView:
    """Where vertices (n, 3), in the drive's map frame, lie inside both images at the ranges in which markings are searched.

    blur_px: as of `blur_of`; blurred images show absence at a shorter range. Empty for a drive that did not search for markings.
    A vertex inside the box of a detection is hidden, and images that show too little show no absence.
    """
    rows = np.flatnonzero(drive.shows_absence) if LANE_MARKING in drive.figures.categories else np.empty(0, np.int64)
    middle_m = vertices_m.mean(axis=0)
    sharp_to_m = params.marking_max_blur_m * drive.rig.left.fx_px / max(blur_px, 1e-9)
    view_to_m = min(params.marking_view_to_m, max(sharp_to_m, params.marking_view_from_m + _STEP_M))
    reach_m = 2 * view_to_m + float(np.linalg.norm(vertices_m - middle_m, axis=1).max())
    rows = rows[np.linalg.norm(drive.map_SE3_left[rows, :3, 3] - middle_m, axis=1) <= reach_m]
    rows = rows[spaced(drive.map_SE3_left[rows, :3, 3], _STEP_M)]
    in_view = np.ones((len(vertices_m), len(rows)), bool)
    for poses, camera, side in (
        (drive.map_SE3_left[rows], drive.rig.left, "left"),
        (drive.map_SE3_right[rows], drive.rig.right, "right"),
    ):
        x, y, z = np.einsum("knj,kji->ink", vertices_m[None] - poses[:, None, :3, 3], poses[:, :3, :3])
        in_view &= (z >= params.marking_view_from_m) & (z <= view_to_m)
        in_view &= np.abs(x) <= params.marking_view_aside_m
        depth = np.where(in_view, z, 1.0)
        u, v = camera.cx_px + camera.fx_px * x / depth, camera.cy_px + camera.fy_px * y / depth
        border = params.visible_border_px
        in_view &= (u >= border) & (u <= camera.width_px - border) & (v >= 0) & (v <= camera.height_px - 1)
        for k, row in enumerate(rows.tolist()):
            for box in drive.detections.get(drive.frames[row], ()):
                if box.side == side:
                    inside = (u[:, k] >= box.x_px) & (u[:, k] <= box.x_px + box.w_px)
                    in_view[:, k] &= ~(inside & (v[:, k] >= box.y_px) & (v[:, k] <= box.y_px + box.h_px))
    shown = in_view.any(axis=0)
    return MarkingView(drive.captured_at_ns[rows[shown]], in_view[:, shown])
