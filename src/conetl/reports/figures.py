"""Objects and lines on plans, the plots of the pages, and what all figures share: colours, axes, PNG, files."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import dates
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation
from numpy.typing import ArrayLike

from conetl.exports.kind_marks import CASING, KIND_MARKS, PAINT, STANDING, KindMark, dashes_of
from conetl.files.atomic import atomic_files
from conetl.model.arrays import Floats
from conetl.model.base import Vec2
from conetl.model.feature_classes import FEATURE_CLASSES, known_classes, letter_of, noun_of
from conetl.model.map_records import Delta, DeltaKind, FeatureChange, MapFeature
from conetl.model.markings import Marking

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
#: Of the formats of figures that are files.
SUFFIXES = (".png", ".svg", ".pdf")
_INK = "#1d2733"
_SYMBOL_PT, _LETTER_PT = 7.5, 6.0
#: Of objects that a drive did not evaluate.
NOT_EVALUATED = STANDING._replace(colour="#bbbbbb", label="not evaluated")
_PAINT_PT, _CASING_PT, _CHANGE_PT = 1.3, 2.4, 2.6
#: Of lines that are gone, in units of their width.
_GONE = (0, (1.6, 1.1))
#: Kinds after which a line is drawn as its paint.
_QUIET = (None, DeltaKind.CONFIRMED, DeltaKind.MISSED)


class PlanMark(NamedTuple):
    """One object on a plan; metres of the map's CRS."""

    category: str
    kind: DeltaKind | None
    """None: no change."""
    xy_m: Vec2
    old_xy_m: Vec2 | None = None
    """Of moved objects."""
    label: str = ""


#: An entry of a legend: the symbol, or letter and symbol; the last has the text.
Handle = Line2D | tuple[Line2D, ...]


def marks_of(deltas: Iterable[Delta | FeatureChange], untouched: Iterable[MapFeature]) -> list[PlanMark]:
    """Those of them that are point objects; untouched: features without a change."""
    marks = [PlanMark(one.category, None, one.xyz_m[:2]) for one in untouched if one.marking is None]
    for delta in deltas:
        if not delta.is_line:
            *old, at = (side.xyz_m[:2] for side in (delta.old, delta.new) if side is not None)
            moved = delta.kind is DeltaKind.MOVED
            shift = f"{delta.shift_m:.2f} m" if moved else ""
            marks.append(PlanMark(delta.state_after.category, delta.kind, at, old[0] if moved else None, shift))
    return marks


def draw_objects(
    axes: Axes,
    xy: Floats,
    categories: Sequence[str],
    mark: KindMark,
    *,
    by_class: bool,
    zorder: float,
) -> list[Handle]:
    """Draw objects of one kind at (N, 2) in the coordinates of the axes, each with the letter of its class to the left of it; the
    entries of the legend with their counts.

    by_class: an entry for each class, instead of one for all.
    """
    marker, colour, label = mark
    edge = colour if marker.startswith("$") else "white"  # a white edge would cover thin signs
    halo = [withStroke(linewidth=2, foreground="white")]
    left = axes.transData + ScaledTranslation(-(_LETTER_PT + _SYMBOL_PT / 2) / 72, 0, axes.figure.dpi_scale_trans)
    handles: list[Handle] = []
    present = set(categories)
    for category in (*known_classes(present), *sorted(present - set(FEATURE_CLASSES))):
        x, y = xy[[one == category for one in categories]].T
        axes.scatter(x, y, marker=marker, s=_SYMBOL_PT**2, color=colour, edgecolors=edge, linewidths=0.8, zorder=zorder)
        text = f"{noun_of(category)}, {label} ({len(x)})" if by_class else f"{label} ({len(categories)})"
        style: dict[str, Any] = {"color": colour, "markeredgecolor": edge, "markeredgewidth": 0.8, "linestyle": ""}
        symbols = [Line2D([], [], marker=marker, markersize=_SYMBOL_PT, label=text, **style)]
        if letter := letter_of(category):
            sign = rf"$\mathbf{{{letter}}}$"
            beside = axes.scatter(x, y, marker=sign, s=_LETTER_PT**2, color=_INK, linewidths=0, transform=left)
            beside.set(path_effects=halo, zorder=zorder + 0.5)
            style = {"color": _INK, "markeredgewidth": 0, "linestyle": ""}
            symbols.insert(0, Line2D([], [], marker=sign, markersize=_LETTER_PT, **style))
        handles.append(tuple(symbols))
    return handles if by_class else handles[:1]


def residuals(range_m: Floats, residual_px: Floats, tracks: Sequence[tuple[float, float]]) -> bytes:
    """Residuals of N positions over range and as a histogram; tracks: (nearest range m, residual px) of each."""
    figure = new_figure(10, 3.3)
    over, histogram = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    over.plot(range_m, residual_px, ".", color=BLUE, markersize=4, alpha=0.6, label=f"positions ({len(range_m)})")
    if tracks:
        near, rms = np.array(tracks).T
        over.plot(near, rms, "^", color=ORANGE, markeredgecolor="white", markersize=7, label=f"objects ({len(near)})")
    over.set_xlabel("range (m); of objects the nearest")
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


def map_size(times: Sequence[datetime], counts: Sequence[int], since: datetime, until: datetime) -> bytes:
    """Number of point objects on the map over system time, with a step at each changeset."""
    figure = new_figure(10, 2.8)
    axes = figure.add_subplot()
    begin, end, *shown = dates.date2num([since, until, *times, until])  # type: ignore[no-untyped-call]
    axes.step(shown, [*counts, counts[-1]], where="post", color=BLUE)
    axes.axvspan(begin, end, color=ORANGE, alpha=0.12, label="this report")
    axes.set_ylim(0, max(1.08 * max(counts), 1))
    locator = dates.AutoDateLocator()  # type: ignore[no-untyped-call]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylabel("objects on the map")
    axes.legend(fontsize=8, loc="lower right")
    add_grid(axes, open_sides=True)
    return png(figure)


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


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of the suffix, or as PNG; completely or not at all. Raises InputError where it cannot."""
    suffix = path.suffix.lower()
    with atomic_files(path) as (file,):
        figure.savefig(file, format=suffix[1:] if suffix in SUFFIXES else "png")
    return path


class MarkingChange(NamedTuple):
    """One stretch of a lane marking, in metres of the map's CRS."""

    line_m: Floats
    """(N, 3)"""
    colour: str
    dash_m: float | None
    gap_m: float | None
    kind: DeltaKind | None
    """None: standing, and not compared."""
    old_line_m: Floats | None
    """(N, 3), of moved ones."""


def changes_of(deltas: Iterable[Delta | FeatureChange], untouched: Iterable[MapFeature]) -> list[MarkingChange]:
    """Those of them that are lane markings."""
    found = [_change(one.marking, None, None) for one in untouched if one.marking is not None]
    for delta in deltas:
        if (shape := delta.state_after.marking) is not None:
            found.append(_change(shape, delta.kind, delta.old.marking if delta.old else None))
    return found


def _change(shape: Marking, kind: DeltaKind | None, old: Marking | None) -> MarkingChange:
    old_m = np.array(old.vertices_m) if old is not None and kind is DeltaKind.MOVED else None
    return MarkingChange(np.array(shape.vertices_m), shape.colour, shape.dash_m, shape.gap_m, kind, old_m)


def change_of_row(row: Mapping[str, Any]) -> MarkingChange:
    """Of a row of `history.changes_of_changeset` with a lane marking."""
    shape, old, kind = row["marking"], row["old_marking"], DeltaKind(row["kind"])
    old_m = None if old is None else np.array(old["line_m"])
    return MarkingChange(np.array(shape["line_m"]), shape["colour"], shape["dash_m"], shape["gap_m"], kind, old_m)


def draw_markings(axes: Axes, changes: Sequence[MarkingChange]) -> list[Line2D]:
    """Draw the lines below all objects. Returns the entries of the legend with their counts."""

    def drawn(lines: Iterable[Floats], colour: str, width_pt: float, **style: object) -> None:
        flat = [line[:, :2] for line in lines]
        axes.add_collection(LineCollection(flat, colors=colour, linewidths=width_pt, **style), autolim=False)  # type: ignore[arg-type]

    handles = []
    quiet = [change for change in changes if change.kind in _QUIET]
    for colour, paint in PAINT.items():
        mine = [change for change in quiet if change.colour == colour]
        parts = [part for one in mine for part in dashes_of(one.line_m, one.dash_m, one.gap_m)]
        drawn(parts, CASING, _CASING_PT, capstyle="butt", zorder=1.5)
        drawn(parts, paint, _PAINT_PT, capstyle="butt", zorder=1.6)
    if quiet:
        handles.append(Line2D([], [], color=CASING, linewidth=_CASING_PT, label=f"lane marking ({len(quiet)})"))
    for kind, mark in KIND_MARKS.items():
        these = [change for change in changes if change.kind is kind]
        if not these or kind in _QUIET:
            continue
        style = {"linestyle": _GONE} if kind.ends else {}
        drawn([one.line_m for one in these], mark.colour, _CHANGE_PT, zorder=2.5, **style)
        olds = [one.old_line_m for one in these if one.old_line_m is not None]
        drawn(olds, mark.colour, _CHANGE_PT / 2, zorder=2.4, linestyle=_GONE)
        label = f"lane marking {mark.label} ({len(these)})"
        handles.append(Line2D([], [], color=mark.colour, linewidth=_CHANGE_PT, label=label, **style))  # type: ignore[arg-type]
    return handles


def counted_by_kind(changes: Iterable[MarkingChange]) -> list[tuple[DeltaKind, int, float]]:
    """Kind, number of stretches and their length (m), in the order of `DeltaKind`."""
    lengths_m: dict[DeltaKind, list[float]] = {kind: [] for kind in DeltaKind}
    for one in changes:
        if one.kind is not None:
            lengths_m[one.kind].append(float(np.linalg.norm(np.diff(one.line_m, axis=0), axis=1).sum()))
    return [(kind, len(some), sum(some)) for kind, some in lengths_m.items() if some]
