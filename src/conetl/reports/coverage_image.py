"""Where the corners of a calibration lie in the two images, and what is left of them: a PNG."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from conetl.files.partial_files import aside
from conetl.geometry.calibration.board_views import BoardView
from conetl.geometry.calibration.stereo_bundle import Bundle, residuals_px

Array = NDArray[np.float64]


def draw_coverage(path: Path, bundle: Bundle, views: Sequence[BoardView], title: str) -> Path:
    """Write the image to `path` and return it: corners of both cameras, their residuals as enlarged arrows."""
    figure = Figure(figsize=(13, 7.2), dpi=110, layout="constrained")
    panels = figure.subplots(1, 2)
    lengths = np.concatenate([np.hypot(*residuals_px(bundle, v).T) for v in views])
    typical = float(np.median(lengths))
    for axes, side, camera in zip(panels, ("left", "right"), (bundle.left, bundle.right), strict=True):
        own = [v for v in views if v.side == side]
        uv = np.concatenate([v.uv_px for v in own])
        residuals = np.concatenate([residuals_px(bundle, v) for v in own])
        # the median arrow is 1.5 % of the image's width, whatever the size of the errors
        enlarge = 0.015 * camera.width_px / max(typical, 1e-9)
        arrows = axes.quiver(
            uv[:, 0], uv[:, 1], residuals[:, 0] * enlarge, residuals[:, 1] * enlarge, np.hypot(*residuals.T),
            angles="xy", scale_units="xy", scale=1.0, width=0.0016, cmap="viridis", clim=(0.0, 3.0 * typical),
        )  # fmt: skip
        axes.plot([camera.cx_px], [camera.cy_px], "+", color="#d55e00", markersize=14, label="principal point")
        axes.set_xlim(-0.5, camera.width_px - 0.5)
        axes.set_ylim(camera.height_px - 0.5, -0.5)
        axes.set_aspect("equal")
        axes.grid(color="#eeeeee")
        axes.set_axisbelow(True)
        axes.set_title(f"{side}: {len(own)} images, {len(uv)} corners, arrows x {enlarge:.0f}")
        axes.set_xlabel("u (px)")
        axes.set_ylabel("v (px)")
        axes.legend(loc="lower right", fontsize=8)
    figure.colorbar(arrows, ax=panels, shrink=0.8, label="length of the residual (px)")
    figure.suptitle(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = aside(path)
    figure.savefig(unfinished, format="png")
    os.replace(unfinished, path)  # noqa: PTH105 - atomic on every platform, unlike Path.rename
    return path
