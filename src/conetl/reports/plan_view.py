"""The plan view of one drive, or of two maps: trajectory, cones of the map and what changed, as a PNG."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from conetl.exports.kind_marks import KIND_MARKS
from conetl.files.partial_files import aside
from conetl.model.map_records import Delta, DeltaKind, FeatureChange, MapFeature

_MARGIN_M = 4.0


def draw_plan_view(
    path: Path,
    *,
    title: str,
    trajectory_m: NDArray[np.float64],
    deltas: Sequence[Delta | FeatureChange],
    untouched: Sequence[MapFeature],
    untouched_label: str = "not in view",
) -> Path:
    """Write the image to `path` (PNG) and return it.

    trajectory_m: (F, 2) easting, northing of the left camera in order of time, (0, 2) where there is none. untouched: features
    that the drive did not judge, or that are the same on both maps.
    """
    points = [trajectory_m, *(_places(d) for d in deltas), *(np.array([f.xyz_m[:2]]) for f in untouched)]
    everything = np.concatenate(points)
    origin = np.floor(everything.min(axis=0))
    low, high = everything.min(axis=0) - origin - _MARGIN_M, everything.max(axis=0) - origin + _MARGIN_M
    width, height = high - low
    figure = Figure(figsize=(10, float(np.clip(10 * height / width + 1.6, 3.2, 10))), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    way = trajectory_m - origin
    if len(way):
        axes.plot(way[:, 0], way[:, 1], color="#777777", linewidth=1.5, label="path of the left camera", zorder=1)
    if len(way) > 1:
        axes.annotate("", xy=way[-1], xytext=way[-2], arrowprops={"arrowstyle": "-|>", "color": "#777777"})
    if untouched:
        rest = np.array([f.xyz_m[:2] for f in untouched]) - origin
        axes.scatter(
            rest[:, 0], rest[:, 1], marker="o", s=22, color="#bbbbbb", label=f"{untouched_label} ({len(rest)})"
        )
    for kind in KIND_MARKS:
        _draw_kind(axes, kind, [d for d in deltas if d.kind == kind], origin)
    frame_plan(axes, low, high, origin)
    axes.set_title(title)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = aside(path)
    figure.savefig(unfinished, format="png", bbox_inches="tight")
    os.replace(unfinished, path)  # noqa: PTH105 - atomic on every platform, unlike Path.rename
    return path


def frame_plan(axes: Axes, low: NDArray[np.float64], high: NDArray[np.float64], origin: NDArray[np.float64]) -> None:
    """Cut a plan at a box, with grid and axes named. low, high: (2,) in metres from `origin`, which is (2,) in the map's CRS."""
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.grid(color="#eeeeee")
    axes.set_axisbelow(True)
    axes.set_xlabel(f"easting - {origin[0]:.0f} (m)")
    axes.set_ylabel(f"northing - {origin[1]:.0f} (m)")


def _draw_kind(
    axes: Axes, kind: DeltaKind, deltas: Sequence[Delta | FeatureChange], origin: NDArray[np.float64]
) -> None:
    if not deltas:
        return
    marker, colour, word = KIND_MARKS[kind]
    places = np.concatenate([_places(d)[-1:] for d in deltas]) - origin
    axes.scatter(
        places[:, 0], places[:, 1], marker=marker, s=60, color=colour, label=f"{word} ({len(deltas)})", zorder=3
    )
    if kind == DeltaKind.MOVED:
        for delta in deltas:
            old, new = _places(delta) - origin
            axes.annotate("", xy=new, xytext=old, arrowprops={"arrowstyle": "->", "color": colour})
            axes.annotate(f"{delta.shift_m:.2f} m", xy=new, xytext=(8, 4), textcoords="offset points", fontsize=8)


def _places(delta: Delta | FeatureChange) -> NDArray[np.float64]:
    """(1 or 2, 2): where it stood and where it stands."""
    return np.array([feature.xyz_m[:2] for feature in (delta.old, delta.new) if feature is not None])
