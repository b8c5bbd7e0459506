"""A drive as `conetl inspect` understood it, on one image: its way with gaps and quality, and one pair with rows drawn."""

from __future__ import annotations

import os
from pathlib import Path
from uuid import uuid4

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from conetl.model.records import Drive, FramePair
from conetl.perception.images import ImageFileError
from conetl.perception.rectified_image import read_rig_image
from conetl.readers.drives.summary import DriveSummary

_RED = "#d55e00"
_ROWS = 12


def draw_drive(path: Path, drive: Drive, summary: DriveSummary) -> Path:
    """Write the image (PNG) to `path` and return it. Raises OSError where it cannot be written."""
    figure = Figure(figsize=(14, 7.5), dpi=110, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.25))
    _draw_way(figure.add_subplot(grid[:, 0]), figure, drive, summary)
    pair = _shown_pair(drive)
    for row, side in enumerate(("left", "right")):
        axes = figure.add_subplot(grid[row, 1])
        axes.set_axis_off()
        if pair is None:
            axes.text(0.5, 0.5, "no image could be read", ha="center")
            continue
        file = Path(pair.left_path if side == "left" else pair.right_path)
        image = read_rig_image(file, drive.rig, "left" if side == "left" else "right")
        axes.imshow(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), interpolation="antialiased")
        height = image.shape[0]
        for v in np.linspace(0, height - 1, _ROWS + 2)[1:-1]:
            axes.axhline(v, color="#ffe000", linewidth=0.6, alpha=0.8)
        axes.set_title(f"{side}, frame {pair.frame_index}: equal rows must cut equal things", fontsize=9)
    lost = summary.expected_pairs - summary.usable_pairs
    rate = f"{summary.rate_hz:.1f} Hz" if summary.rate_hz else "one pair"
    figure.suptitle(
        f"{summary.drive_id}: {summary.usable_pairs} of {summary.expected_pairs} pairs usable ({lost} lost), {rate}, "
        f"{summary.length_m:.0f} m, base {summary.rig.baseline_m:.3f} m, EPSG:{summary.map_srid}"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_suffix(f".{uuid4().hex}.tmp")
    figure.savefig(aside, format="png")
    os.replace(aside, path)  # noqa: PTH105 - atomic on every platform, unlike Path.rename
    return path


def _draw_way(axes: Axes, figure: Figure, drive: Drive, summary: DriveSummary) -> None:
    places = np.array([pair.pose.map_t_body_m[:2] for pair in drive.frame_pairs])
    origin = places[0]
    local = places - origin
    number = {pair.frame_index: i for i, pair in enumerate(drive.frame_pairs)}
    sigma_m = np.array([max(pair.pose.sigma_enu_m[:2]) for pair in drive.frame_pairs])
    axes.plot(*local.T, color="#bbbbbb", linewidth=1, zorder=1)
    for i, gap in enumerate(summary.gaps):
        ends = local[[number[gap.after_frame], number[gap.before_frame]]]
        label = "gap in time or space" if i == 0 else None
        axes.plot(*ends.T, color=_RED, linewidth=2.5, linestyle="--", zorder=2, label=label)
        axes.annotate(
            f"{gap.seconds:.1f} s, {gap.metres:.0f} m", ends.mean(axis=0), fontsize=7, color=_RED,
            xytext=(6, 6), textcoords="offset points",
        )  # fmt: skip
    points = axes.scatter(
        local[:, 0],
        local[:, 1],
        c=sigma_m,
        s=14,
        cmap="viridis",
        vmin=0.0,
        vmax=max(float(sigma_m.max()), 1e-3),
        zorder=3,
    )
    if summary.poses.jumps:
        jumps = local[[number[jump.frame] for jump in summary.poses.jumps]]
        axes.scatter(jumps[:, 0], jumps[:, 1], marker="x", s=60, color=_RED, zorder=4, label="jump")
    axes.plot(*local[0], marker="^", color="black", markersize=9, linestyle="none", label="start", zorder=5)
    span = float(np.ptp(local, axis=0).max())
    middle = (local.max(axis=0) + local.min(axis=0)) / 2
    half = max(0.55 * span, 2.0)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.grid(color="#eeeeee")
    axes.set_axisbelow(True)
    axes.set_xlabel(f"east of {origin[0]:.1f} m")
    axes.set_ylabel(f"north of {origin[1]:.1f} m")
    axes.legend(loc="best", fontsize=8)
    figure.colorbar(points, ax=axes, shrink=0.6, label="horizontal sigma of the pose (m)", location="bottom")


def _shown_pair(drive: Drive) -> FramePair | None:
    """The pair nearest to the middle whose images are there and can be decoded (of a bag only the first is unpacked)."""
    pairs = drive.frame_pairs
    for i in sorted(range(len(pairs)), key=lambda i: abs(i - len(pairs) // 2)):
        pair = pairs[i]
        try:
            if all(Path(p).is_file() for p in (pair.left_path, pair.right_path)):
                read_rig_image(Path(pair.left_path), drive.rig, "left")
                read_rig_image(Path(pair.right_path), drive.rig, "right")
                return pair
        except ImageFileError:
            continue
    return None
