"""Figures of the QA reports as PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from conetl.exports.kind_marks import KIND_MARKS
from conetl.model.map_records import DeltaKind
from conetl.reports.accuracy_plots import png
from conetl.reports.drive_facts import Change
from conetl.reports.plan_view import frame_plan

Floats = NDArray[np.float64]
_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#777777"
_DPI = 130
_MARGIN_M = 5.0
#: More numbers than this on one plan cannot be read.
_MAX_LABELS = 80


def plan(path_m: Floats, changes: Sequence[Change], others_m: Floats) -> bytes:
    """Path (F, 2), changes with the numbers of the table, and features that the drive did not judge (M, 2); map CRS."""
    places = np.array([c.xyz_m[:2] for c in changes]).reshape(-1, 2)
    olds = np.array([c.old_xy_m for c in changes if c.old_xy_m is not None]).reshape(-1, 2)
    everything = np.concatenate([path_m, places, olds, others_m])
    origin = np.floor(everything.min(axis=0))
    low, high = everything.min(axis=0) - origin - _MARGIN_M, everything.max(axis=0) - origin + _MARGIN_M
    width, height = high - low
    figure = Figure(figsize=(10, float(np.clip(10 * height / width + 1.0, 3.4, 6.5))), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    way = path_m - origin
    axes.plot(way[:, 0], way[:, 1], color=_GREY, linewidth=1.4, label="path of the left camera", zorder=1)
    if len(way) > 1:
        axes.annotate("", xy=way[-1], xytext=way[-2], arrowprops={"arrowstyle": "-|>", "color": _GREY})
    if len(others_m):
        rest = others_m - origin
        axes.scatter(rest[:, 0], rest[:, 1], s=14, color="#bbbbbb", label=f"not judged ({len(rest)})")
    labelled = [c for c in changes if not c.is_confirmation]
    labelled = (labelled + [c for c in changes if c.is_confirmation])[:_MAX_LABELS]
    for kind in DeltaKind:
        group = [c for c in changes if c.kind is kind]
        if not group:
            continue
        marker, colour, word = KIND_MARKS[kind]
        at = np.array([c.xyz_m[:2] for c in group]) - origin
        axes.scatter(at[:, 0], at[:, 1], marker=marker, s=46, color=colour, label=f"{word} ({len(group)})", zorder=3)
    for change in labelled:
        at = np.array(change.xyz_m[:2]) - origin
        if change.kind is DeltaKind.MOVED and change.old_xy_m is not None:
            arrow = {"arrowstyle": "->", "color": KIND_MARKS[DeltaKind.MOVED].colour}
            axes.annotate("", xy=at, xytext=np.array(change.old_xy_m) - origin, arrowprops=arrow)
        axes.annotate(str(change.number), xy=at, xytext=(5, 5), textcoords="offset points", fontsize=8)
    frame_plan(axes, low, high, origin)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return png(figure)


def residuals(range_m: Floats, residual_px: Floats, tracks: Sequence[tuple[float, float]]) -> bytes:
    """Residuals of N positions over range and as a histogram; tracks: (nearest range m, residual px) of each."""
    figure = Figure(figsize=(10, 3.3), dpi=_DPI, layout="constrained")
    over, histogram = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    over.plot(range_m, residual_px, ".", color=_BLUE, markersize=4, alpha=0.6, label=f"positions ({len(range_m)})")
    if tracks:
        near, rms = np.array(tracks).T
        over.plot(near, rms, "^", color=_ORANGE, markeredgecolor="white", markersize=7, label=f"cones ({len(near)})")
    over.set_xlabel("range (m); of cones the nearest")
    over.set_ylabel("residual (px, RMS)")
    over.set_ylim(bottom=0)
    over.legend(fontsize=8)
    histogram.hist(residual_px, bins=30, color=_BLUE)
    for share, style in ((50, "-"), (95, "--")):
        value = float(np.percentile(residual_px, share))
        histogram.axvline(value, color=_ORANGE, linestyle=style, label=f"{share} %: {value:.2f} px")
    histogram.set_xlabel("residual of a position (px, RMS)")
    histogram.set_ylabel("positions")
    histogram.legend(fontsize=8)
    return _finished(figure, over, histogram)


def existence(probabilities: Floats, least: float | None) -> bytes:
    """Existence probabilities of a drive's cones; least: below it a group of boxes is refused."""
    figure = Figure(figsize=(10, 2.5), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    axes.hist(probabilities, bins=np.linspace(0, 1, 41).tolist(), color=_BLUE)
    if least is not None:
        axes.axvline(least, color=_ORANGE, linestyle="--", label=f"refused below {least:g}")
        axes.legend(fontsize=8, loc="upper left")
    axes.set_xlim(0, 1)
    axes.set_xlabel("existence probability by this drive alone")
    axes.set_ylabel("cones")
    return _finished(figure, axes)


def timeline(steps: Sequence[tuple[str, float, float]]) -> bytes:
    """When each step ran: (name, start s, end s)."""
    figure = Figure(figsize=(10, 0.55 + 0.24 * len(steps)), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    names, starts, ends = zip(*steps, strict=True)
    axes.barh(names, np.maximum(np.subtract(ends, starts), 0.01), left=starts, color=_BLUE, height=0.6)
    axes.invert_yaxis()
    axes.set_xlabel("seconds since the run began")
    return _finished(figure, axes)


def map_size(times: Sequence[datetime], counts: Sequence[int], since: datetime, until: datetime) -> bytes:
    """Number of cones on the map over system time, a step at each changeset."""
    figure = Figure(figsize=(10, 2.8), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot()
    shown = [_days(at) for at in (*times, until)]
    axes.step(shown, [*counts, counts[-1]], where="post", color=_BLUE)
    axes.axvspan(_days(since), _days(until), color=_ORANGE, alpha=0.12, label="this report")
    axes.set_ylim(0, max(1.08 * max(counts), 1))
    locator = dates.AutoDateLocator()  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.set_ylabel("cones on the map")
    axes.legend(fontsize=8, loc="lower right")
    return _finished(figure, axes)


def _days(at: datetime) -> float:
    return float(dates.date2num(at))  # type: ignore[no-untyped-call]


def _finished(figure: Figure, *every: Axes) -> bytes:
    for axes in every:
        axes.grid(color="#eeeeee")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return png(figure)
