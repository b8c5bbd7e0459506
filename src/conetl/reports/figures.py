"""Plan views of drives and map differences, the plots of the pages, and what all figures share: colours, axes, PNG, files."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from conetl.exports.kind_marks import KIND_MARKS
from conetl.files.atomic import atomic_files
from conetl.model.map_records import Delta, DeltaKind, FeatureChange, MapFeature
from conetl.reports.marking_lines import MarkingChange, changes_of, draw_markings, ends_of

Floats = NDArray[np.float64]
#: Safe for the colour-blind (Okabe & Ito).
BLUE, SKY, GREEN, ORANGE, PINK, GREY, BLACK = (
    "#0072b2",
    "#56b4e9",
    "#009e73",
    "#d55e00",
    "#cc79a7",
    "#777777",
    "#222222",
)
DPI = 130
_MARGIN_M = 5.0
#: Labels of more changes than this cannot be read.
_MAX_LABELS = 80


class PlanMark(NamedTuple):
    """One change on a plan; metres of the map's CRS."""

    kind: DeltaKind
    xy_m: ArrayLike
    old_xy_m: ArrayLike | None
    """Of moved cones."""
    label: str = ""


def draw_plan_view(
    path: Path,
    *,
    title: str,
    trajectory_m: Floats,
    deltas: Sequence[Delta | FeatureChange],
    untouched: Sequence[MapFeature],
    untouched_label: str = "not evaluated",
) -> Path:
    """Write the plan of a drive, or of the difference of two maps, to `path` (PNG) and return it.

    trajectory_m: (F, 2) easting, northing of the left camera in order of time, (0, 2) without one. untouched: features without a
    change.
    """
    marks = []
    lines = changes_of(deltas, untouched)
    for delta in deltas:
        if delta.is_of_line:
            continue
        *old, at = (np.array(side.xyz_m[:2]) for side in (delta.old, delta.new) if side is not None)
        moved = delta.kind is DeltaKind.MOVED
        marks.append(PlanMark(delta.kind, at, old[0] if moved else None, f"{delta.shift_m:.2f} m" if moved else ""))
    others = np.array([feature.xyz_m[:2] for feature in untouched if feature.marking is None]).reshape(-1, 2)
    figure = plan(trajectory_m, marks, others, lines, others_label=untouched_label)
    figure.suptitle(title)
    return save_figure(figure, path)


def plan(
    path_m: Floats, marks: Sequence[PlanMark], others_m: Floats, lines: Sequence[MarkingChange], *, others_label: str
) -> Figure:
    """Drive path (F, 2), changes, objects without a change (M, 2), and lane markings, in the map's CRS."""
    olds = [mark.old_xy_m for mark in marks if mark.old_xy_m is not None]
    at_m = np.reshape([*(mark.xy_m for mark in marks), *olds], (-1, 2))
    everything = np.concatenate([path_m, others_m, at_m, ends_of(lines)])
    origin = np.floor(everything.min(axis=0))
    low, high = everything.min(axis=0) - origin - _MARGIN_M, everything.max(axis=0) - origin + _MARGIN_M
    height = 10 * (high[1] - low[1]) / (high[0] - low[0]) + 1.0
    figure = new_figure(10, float(np.clip(height, 3.4, 6.5)))
    axes = figure.add_subplot()
    if len(path_m):
        x, y = (path_m - origin).T
        axes.plot(x, y, zorder=1, color=GREY, linewidth=1.4, label="path of the left camera")
    if len(path_m) > 1:
        draw_arrow(axes, path_m[-2] - origin, path_m[-1] - origin, GREY, "-|>")
    if len(others_m):
        others = others_m - origin
        axes.scatter(others[:, 0], others[:, 1], s=14, color="#bbbbbb", label=f"{others_label} ({len(others)})")
    for kind, (marker, colour, label) in KIND_MARKS.items():
        group = [mark for mark in marks if mark.kind is kind]
        if group:
            at = np.array([mark.xy_m for mark in group]) - origin
            axes.scatter(
                at[:, 0], at[:, 1], marker=marker, s=46, color=colour, label=f"{label} ({len(group)})", zorder=3
            )
    for mark in sorted(marks, key=lambda mark: mark.kind is DeltaKind.CONFIRMED)[:_MAX_LABELS]:
        at = np.asarray(mark.xy_m) - origin
        if mark.kind is DeltaKind.MOVED and mark.old_xy_m is not None:
            draw_arrow(axes, np.asarray(mark.old_xy_m) - origin, at, KIND_MARKS[mark.kind].colour)
        axes.annotate(mark.label, xy=at, xytext=(5, 5), textcoords="offset points", fontsize=8)
    handles = [*axes.get_legend_handles_labels()[0], *draw_markings(axes, lines, origin)]
    frame_plan(axes, low, high, origin)
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def residuals(range_m: Floats, residual_px: Floats, tracks: Sequence[tuple[float, float]]) -> bytes:
    """Residuals of N positions over range and as a histogram; tracks: (nearest range m, residual px) of each."""
    figure = new_figure(10, 3.3)
    over, histogram = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    over.plot(range_m, residual_px, ".", color=BLUE, markersize=4, alpha=0.6, label=f"positions ({len(range_m)})")
    if tracks:
        near, rms = np.array(tracks).T
        over.plot(near, rms, "^", color=ORANGE, markeredgecolor="white", markersize=7, label=f"cones ({len(near)})")
    over.set_xlabel("range (m); of cones the nearest")
    over.set_ylabel("residual (px, RMS)")
    over.set_ylim(bottom=0)
    over.legend(fontsize=8)
    histogram.hist(residual_px, bins=30, color=BLUE)
    for share, style in ((50, "-"), (95, "--")):
        value = float(np.percentile(residual_px, share))
        histogram.axvline(value, color=ORANGE, linestyle=style, label=f"{share} %: {value:.2f} px")
    histogram.set_xlabel("residual of a position (px, RMS)")
    histogram.set_ylabel("positions")
    histogram.legend(fontsize=8)
    add_grid(over, histogram, open_sides=True)
    return png(figure)


def existence(probabilities: Floats, least: float | None) -> bytes:
    """Existence probabilities of a drive's cones; least: the threshold for a new cone."""
    figure = new_figure(10, 2.5)
    axes = figure.add_subplot()
    axes.hist(probabilities, bins=np.linspace(0, 1, 41).tolist(), color=BLUE)
    if least is not None:
        axes.axvline(least, color=ORANGE, linestyle="--", label=f"rejected below {least:g}")
        axes.legend(fontsize=8, loc="upper left")
    axes.set_xlim(0, 1)
    axes.set_xlabel("existence probability from this drive alone")
    axes.set_ylabel("cones")
    add_grid(axes, open_sides=True)
    return png(figure)


def timeline(steps: Sequence[tuple[str, float, float]]) -> bytes:
    """When each step ran: (name, start s, end s)."""
    figure = new_figure(10, 0.55 + 0.24 * len(steps))
    axes = figure.add_subplot()
    names, starts, ends = zip(*steps, strict=True)
    axes.barh(names, np.maximum(np.subtract(ends, starts), 0.01), left=starts, color=BLUE, height=0.6)
    axes.invert_yaxis()
    axes.set_xlabel("seconds since the start of the run")
    add_grid(axes, open_sides=True)
    return png(figure)


def map_size(times: Sequence[datetime], counts: Sequence[int], since: datetime, until: datetime) -> bytes:
    """Number of cones on the map over system time, with a step at each changeset."""
    figure = new_figure(10, 2.8)
    axes = figure.add_subplot()
    begin, end, *shown = dates.date2num([since, until, *times, until])  # type: ignore[no-untyped-call]
    axes.step(shown, [*counts, counts[-1]], where="post", color=BLUE)
    axes.axvspan(begin, end, color=ORANGE, alpha=0.12, label="this report")
    axes.set_ylim(0, max(1.08 * max(counts), 1))
    locator = dates.AutoDateLocator()  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_ylabel("cones on the map")
    axes.legend(fontsize=8, loc="lower right")
    add_grid(axes, open_sides=True)
    return png(figure)


def frame_plan(axes: Axes, low: Floats, high: Floats, origin: Floats) -> None:
    """Limit a plan to a box and label its axes. low, high: (2,) in metres from `origin`, which is (2,) in the map's CRS."""
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    add_grid(axes)
    axes.set_xlabel(f"easting - {origin[0]:.0f} (m)")
    axes.set_ylabel(f"northing - {origin[1]:.0f} (m)")


def draw_arrow(
    axes: Axes, start: ArrayLike, end: ArrayLike, colour: str, style: str = "->", *, zorder: float = 3, **more: object
) -> None:
    """An arrow between two points (2,) of the axes' coordinates. more: `arrowprops` of matplotlib."""
    start_xy, end_xy = (tuple(np.asarray(point, float).tolist()) for point in (start, end))
    arrow = {"arrowstyle": style, "color": colour, **more}
    axes.annotate("", xy=end_xy, xytext=start_xy, arrowprops=arrow, zorder=zorder)


def new_figure(width_in: float, height_in: float, *, dpi: int = DPI) -> Figure:
    """An empty figure whose parts make space for each other."""
    return Figure(figsize=(width_in, height_in), dpi=dpi, layout="constrained")


def add_grid(*every: Axes, open_sides: bool = False) -> None:
    """A light grid behind the data; open_sides: no frame at the top and right."""
    for axes in every:
        axes.grid(color="#eeeeee")
        axes.set_axisbelow(True)
        if open_sides:
            axes.spines[["top", "right"]].set_visible(False)


def png(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def save_figure(figure: Figure, path: Path, *, suffixes: Iterable[str] = (".png",)) -> Path:
    """Write a figure in the format of the suffix, or as PNG; completely or not at all. Raises InputError where it cannot."""
    suffix = path.suffix.lower()
    with atomic_files(path) as (file,):
        figure.savefig(file, format=suffix[1:] if suffix in suffixes else "png")
    return path
