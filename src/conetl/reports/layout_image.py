"""The layout of work zones along their roads as an image: station to the right, offset upwards."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from conetl.geometry.linear_reference import project
from conetl.model.work_zone_records import DrivePath, LayoutFinding, Level, Rule, WorkZone
from conetl.reports.figures import BLUE, GREEN, ORANGE, add_grid, draw_arrow, new_figure, save_figure

_LEVEL_COLOUR = {Level.VIOLATION: ORANGE, Level.DEVIATION: ORANGE, Level.NOTICE: BLUE, Level.CANNOT_TELL: "#8a8a8a"}
_CONE, _ROW, _TAPER, _LANE = "#e69f00", "#555555", "#f0e442", "#999999"
_MARGIN_M = 8.0


def draw_layout(
    path: Path,
    zones: Sequence[tuple[WorkZone, Sequence[LayoutFinding]]],
    paths: Sequence[DrivePath],
    *,
    title: str,
) -> Path:
    """Write an image (PNG) with a panel and a numbered list of findings per zone. Returns the path."""
    notes = [[_note(n, finding) for n, finding in enumerate(findings, 1)] for _, findings in zones]
    heights = [part for some in notes for part in (2.9, 0.3 + 0.2 * max(sum(len(note) for note in some), 1))]
    figure = new_figure(11, sum(heights) + 0.5, dpi=120)
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    axes = figure.subplots(2 * len(zones), 1, height_ratios=heights, squeeze=False)[:, 0]
    for k, (zone, findings) in enumerate(zones):
        _panel(axes[2 * k], zone, findings, paths)
        _list(axes[2 * k + 1], findings, notes[k])
    return save_figure(figure, path)


def _note(number: int, finding: LayoutFinding) -> list[str]:
    text = f"{number}  {finding.level}: {finding.text} [{finding.norm}]"
    return textwrap.wrap(text, 128, subsequent_indent="     ")


def _panel(ax: Axes, zone: WorkZone, findings: Sequence[LayoutFinding], paths: Sequence[DrivePath]) -> None:
    layout = zone.layout
    zero = float(layout.stations_m[0])
    s, o = layout.stations_m - zero, layout.offsets_m
    low, high = float(s[0]) - _MARGIN_M, float(s[-1]) + _MARGIN_M
    if layout.bands is not None:
        for k in range(layout.bands.offsets_m.shape[1]):
            label = "lane lines" if k == 0 else None
            ax.plot(layout.bands.stations_m - zero, layout.bands.offsets_m[:, k], color=_LANE, linewidth=1, label=label)
    _drives(ax, zone, paths, zero)
    for n, row in enumerate(layout.rows):
        members = list(row.members)
        ax.plot(s[members], o[members], color=_ROW, linewidth=1, zorder=2, label="row" if n == 0 else None)
        for m, taper in enumerate(row.tapers):
            label = "taper" if n == m == 0 else None
            ends = taper.start.station_m - zero, taper.end.station_m - zero
            ax.axvspan(*ends, color=_TAPER, alpha=0.3, linewidth=0, label=label)
    ax.errorbar(
        s, o, xerr=2 * layout.sigmas_s_m, yerr=2 * layout.sigmas_o_m, fmt="^", color=_CONE, markeredgecolor="black",
        markeredgewidth=0.5, markersize=7, elinewidth=1, label="cones, 2 sigma", zorder=3,
    )  # fmt: skip
    for number, finding in enumerate(findings, 1):
        _mark(ax, number, finding, zone, zero)
    inside = o if layout.bands is None else np.append(o, layout.bands.offsets_m[np.isfinite(layout.bands.offsets_m)])
    ax.set_xlim(low, high)
    ax.set_ylim(
        max(float(np.min(inside)), float(o.min()) - 6) - 1.5, min(float(np.max(inside)), float(o.max()) + 6) + 1.8
    )
    ax.set_ylabel("offset, positive to the left (m)")
    ax.set_xlabel("along the road in the direction of travel (m)" if layout.direction_known else "along the row (m)")
    source = {"lanes": "a lane line", "drives": "the drive path", "cones": "the cones themselves"}[layout.axis_source]
    ax.set_title(
        f"work zone {str(zone.history.zone_id)[:8]}, {len(s)} cones; offsets from {source}", loc="left", fontsize=9
    )
    add_grid(ax)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)


def _drives(ax: Axes, zone: WorkZone, paths: Sequence[DrivePath], zero: float) -> None:
    label: str | None = "drives"
    for one in paths:
        if one.drive_id not in zone.layout.drive_ids:
            continue
        s, o = project(zone.layout.axis_m, one.xy_m)
        near = (np.abs(o) < 15) & (s > zero - 200) & (s < float(zone.layout.stations_m[-1]) + 200)
        if near.sum() < 2:
            continue
        along, offset = s[near] - zero, o[near]
        ax.plot(along, offset, color=GREEN, linewidth=1.2, linestyle="--", label=label, zorder=1)
        # The arrow is in the middle of the visible part.
        shown = np.flatnonzero((along > -_MARGIN_M) & (along < float(zone.layout.stations_m[-1]) - zero + _MARGIN_M))
        if len(shown) > 1:
            a, b = shown[len(shown) // 2 - 1], shown[len(shown) // 2]
            draw_arrow(ax, (along[a], offset[a]), (along[b], offset[b]), GREEN, "-|>")
        label = None


def _mark(ax: Axes, number: int, finding: LayoutFinding, zone: WorkZone, zero: float) -> None:
    index = {cone.feature_id: k for k, cone in enumerate(zone.layout.cones)}
    those = [index[feature_id] for feature_id in finding.feature_ids]
    s, o = zone.layout.stations_m[those] - zero, zone.layout.offsets_m[those]
    colour = _LEVEL_COLOUR[finding.level]
    if finding.rule is Rule.CONE_IN_LANE:
        ax.plot(s, o, "o", markersize=16, markerfacecolor="none", markeredgecolor=colour, markeredgewidth=2, zorder=4)
    elif finding.rule is not Rule.TAPER_LENGTH:
        ax.plot(s, o, color=colour, linewidth=5, alpha=0.6, solid_capstyle="butt", zorder=2)
    ax.annotate(
        str(number), xy=(float(np.mean(s)), float(np.mean(o))), xytext=(0, 14), textcoords="offset points", ha="center",
        va="center", fontsize=8, color="white", fontweight="bold", zorder=5,
        bbox={"boxstyle": "circle,pad=0.25", "facecolor": colour, "edgecolor": "none"},
    )  # fmt: skip


def _list(ax: Axes, findings: Sequence[LayoutFinding], notes: Sequence[Sequence[str]]) -> None:
    ax.axis("off")
    if not findings:
        ax.text(0.0, 1.0, "No finding.", va="top", fontsize=8.5, transform=ax.transAxes)
        return
    lines = [(line, finding.level) for finding, note in zip(findings, notes, strict=True) for line in note]
    for row, (line, level) in enumerate(lines):
        y = 1.0 - row / len(lines)
        ax.text(0.0, y, line, va="top", fontsize=8.5, transform=ax.transAxes, color=_LEVEL_COLOUR[level])
