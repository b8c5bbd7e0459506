"""Figures of the QA reports as PNG bytes."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np
from matplotlib import dates

from conetl.reports.plans import BLUE, ORANGE, Floats, add_grid, new_figure, png


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
