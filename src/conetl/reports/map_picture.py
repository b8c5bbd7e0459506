"""Plans of maps, drives and nights: cones, lane markings, paths, lane boundaries, LiDAR points, scale bar, legend and CRS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MaxNLocator
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from numpy.typing import NDArray
from pyproj import CRS

from conetl.db.connection import Connection
from conetl.db.map.map_store import Bbox, list_changesets, read_paths
from conetl.db.serve_store import read_base_tile, read_rows
from conetl.exports import kind_marks as marks
from conetl.exports.kind_marks import STANDING, KindMark
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.feature_classes import letter_of
from conetl.model.map_records import DeltaKind
from conetl.readers.base_layers.point_tiles import decode_points, tile_side_m
from conetl.reports import figures
from conetl.reports.figures import MarkingChange, PlanMark

_INK = "#1d2733"
_MARGIN = 0.06
_MIN_SPAN_M = 12.0
#: Labels of more changes than this cannot be read.
_MAX_LABELS = 80
_LABEL_PT = 7.5
_DPI = 200
_MM = 1 / 25.4
_MAX_POINTS = 400_000
_MAX_TILES = 100_000
_MAX_LINES = 200_000
_NOWHERE, _NO_SHADES = np.empty((0, 2)), np.empty(0, np.uint8)


class PlanContent(NamedTuple):
    """The content of a plan, in metres of the map's CRS."""

    srid: int
    marks: Sequence[PlanMark]
    """Point objects, each with its change."""
    markings: Sequence[MarkingChange]
    paths_m: Sequence[Floats] = ()
    """(N, 2) each: paths of the drives."""
    others: KindMark = STANDING
    """How objects without a change are shown."""
    boundaries_m: Sequence[Floats] = ()
    """(N, 2) each: lane boundaries."""
    points_m: Floats = _NOWHERE
    """(N, 2) LiDAR points."""
    shades: NDArray[np.uint8] = _NO_SHADES
    """(N,) their intensity."""

    def extent(self) -> Bbox:
        """West, south, east, north around all cones, lane markings and paths, with a margin. Raises InputError where there is
        none."""
        lines = (line for one in self.markings for line in (one.line_m, one.old_line_m) if line is not None)
        olds = [mark.old_xy_m for mark in self.marks if mark.old_xy_m is not None]
        at_m = np.reshape([*(mark.xy_m for mark in self.marks), *olds], (-1, 2))
        places = np.concatenate([at_m, *(line[:, :2] for line in lines), *self.paths_m])
        if not len(places):
            raise InputError("the map has no cones at that time: choose another time, or an area with --bbox")
        low, high = places.min(axis=0), places.max(axis=0)
        margin = max(_MARGIN * float((high - low).max()), 3.0)
        half = np.maximum((high - low) / 2 + margin, _MIN_SPAN_M / 2)
        (west, south), (east, north) = (low + high) / 2 - half, (low + high) / 2 + half
        return float(west), float(south), float(east), float(north)


def with_surroundings(
    conn: Connection,
    map_name: str,
    content: PlanContent,
    extent: Bbox,
    valid_at: datetime | None,
    known_at: datetime | None,
) -> PlanContent:
    """The content with drive paths, and what the database holds around an extent: west, south, east, north in the map's CRS."""
    west, south, east, north = extent
    margin = max(east - west, north - south)  # the paper has another shape than the extent
    around = (west - margin, south - margin, east + margin, north + margin)
    points_m, shades = _points(conn, map_name, around)
    paths_m, boundaries_m = drive_paths(conn, map_name, valid_at, known_at), _lane_boundaries(conn, map_name, around)
    return content._replace(paths_m=paths_m, boundaries_m=boundaries_m, points_m=points_m, shades=shades)


def drive_paths(conn: Connection, map_name: str, valid_at: datetime | None, known_at: datetime | None) -> list[Floats]:
    """(N, 2) drive paths until an instant, of the drives committed until an instant of the database."""
    paths = read_paths(conn, map_name=map_name, until=valid_at)
    if known_at is None:
        return [path.xy_m for path in paths]
    known = {c.drive_id for c in list_changesets(conn, map_name=map_name) if c.committed_at <= known_at}
    return [path.xy_m for path in paths if path.drive_id in known]


def _lane_boundaries(conn: Connection, map_name: str, around: Bbox) -> list[Floats]:
    rows = read_rows(conn, "base_layers.lines", map_name=map_name, max_rows=_MAX_LINES)
    shapes = shapely.from_wkb([bytes(row["geom"]) for row in rows])
    return [shapely.get_coordinates(shape) for shape in shapes if shapely.intersects(shape, shapely.box(*around))]


def _points(conn: Connection, map_name: str, around: Bbox) -> tuple[Floats, NDArray[np.uint8]]:
    """(N, 2) points and (N,) intensities of the tiles around, coarse ones first, up to _MAX_POINTS."""
    west, south, east, north = around
    points, shades, count = [_NOWHERE], [_NO_SHADES], 0
    for row in read_rows(conn, "base_layers.tiles", map_name=map_name, max_rows=_MAX_TILES):
        x, y = row["origin_m"][:2]
        side = tile_side_m(row["level"])
        if x > east or y > north or x + side < west or y + side < south:
            continue
        count += row["points"]
        payload = read_base_tile(conn, map_name, row["sha256"]) if count <= _MAX_POINTS else None
        if payload is None:
            break
        steps, shade = decode_points(payload)
        points.append(steps[:, :2] * np.array(row["scale_m"][:2]) + (x, y))
        shades.append(shade)
    return np.concatenate(points), np.concatenate(shades)


def draw_plan(
    content: PlanContent,
    *,
    bbox: Bbox | None = None,
    title: str = "",
    footer: str = "grid north",
    size_mm: tuple[float, float] | None = None,
) -> Figure:
    """The figure at 200 dpi. bbox: west, south, east, north; None: around the content. size_mm: width and height; None: 240 wide,
    with the height of the bbox. footer: the line below. Raises InputError where there is nothing to draw."""
    west, south, east, north = bbox or content.extent()
    if size_mm is None:
        size_mm = (240.0, float(np.clip(240 * 0.78 * (north - south) / (east - west) + 34, 96, 300)))
    figure = _compose(content, (west, south, east, north), title, footer, size_mm)
    figure.draw_without_rendering()  # the size of the map depends on that of title and legend
    paper = figure.axes[0].get_position(original=True)
    wide = paper.width * size_mm[0] / (paper.height * size_mm[1])
    width, height = max(east - west, (north - south) * wide), max(north - south, (east - west) / wide)
    x, y = (west + east) / 2, (south + north) / 2
    return _compose(content, (x - width / 2, y - height / 2, x + width / 2, y + height / 2), title, footer, size_mm)


def _compose(content: PlanContent, bbox: Bbox, title: str, footer: str, size_mm: tuple[float, float]) -> Figure:
    """The figure of exactly `bbox`."""
    west, south, east, north = bbox
    figure = figures.new_figure(size_mm[0] * _MM, size_mm[1] * _MM, dpi=_DPI)
    axes = figure.add_subplot()
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_autoscale_on(False)
    axes.set_aspect("equal")
    handles = [*_objects(axes, content, bbox), *_markings(axes, content, bbox), *_ground(axes, content)]
    _frame(axes)
    _scale_bar(axes, bbox)
    _north(axes)
    figure.suptitle(title, x=0.012, ha="left", fontsize=13, fontweight="bold", color=_INK)
    if handles:
        texts = [str((one[-1] if isinstance(one, tuple) else one).get_label()) for one in handles]
        together = {tuple: HandlerTuple(ndivide=None, pad=0.4)}
        style: dict[str, Any] = {"handler_map": together, "frameon": False, "fontsize": 8.5, "handletextpad": 0.6}
        figure.legend(handles, texts, loc="outside right upper", **style)  # type: ignore[call-overload]
    crs = CRS.from_epsg(content.srid)
    figure.supxlabel(
        f"EPSG:{content.srid} ({crs.name}) · {footer}", x=0.012, ha="left", fontsize=7.5, color=marks.DRIVE_PATH
    )
    return figure


def _ground(axes: Axes, content: PlanContent) -> list[Line2D]:
    """Draw points, lane boundaries and paths. Returns their lines for the legend."""
    handles: list[Line2D] = []
    for path in content.paths_m:
        axes.plot(path[:, 0], path[:, 1], color=marks.DRIVE_PATH, linewidth=1.1, zorder=3)
        if len(path) > 1:
            before, tip = path[len(path) // 2 - 1], path[len(path) // 2]
            # Only the head: annotations are not clipped at the frame, and a segment may come from far outside of it.
            start = tip - (tip - before) / max(float(np.linalg.norm(tip - before)), 1e-9) * 1e-3
            figures.draw_arrow(axes, start, tip, marks.DRIVE_PATH, "-|>", linewidth=1.1, shrinkA=0, shrinkB=0)
    if content.paths_m:
        handles.append(Line2D([], [], color=marks.DRIVE_PATH, linewidth=1.3, label="drive path"))
    if content.boundaries_m:
        axes.add_collection(
            LineCollection(list(content.boundaries_m), colors=marks.LANE, linewidths=0.9, zorder=2), autolim=False
        )
        handles.append(Line2D([], [], color=marks.LANE, linewidth=1.1, label="lane boundary"))
    if len(content.points_m):
        colours = LinearSegmentedColormap.from_list("points", [marks.DARK_POINT, marks.BRIGHT_POINT])
        shades = content.shades / 255
        axes.scatter(
            content.points_m[:, 0],
            content.points_m[:, 1],
            c=colours(shades),
            s=0.8,
            linewidths=0,
            zorder=1,
            rasterized=True,
        )
        handles.append(Line2D([], [], color=marks.DARK_POINT, marker=".", linestyle="", label="LiDAR point"))
    return handles


def _markings(axes: Axes, content: PlanContent, bbox: Bbox) -> list[Line2D]:
    """Draw lane markings and their changes. Returns their lines for the legend."""
    low, high = np.array(bbox[:2]), np.array(bbox[2:])
    shown = [
        one
        for one in content.markings
        for xy_m in [one.line_m[:, :2]]
        if (xy_m.max(axis=0) >= low).all() and (xy_m.min(axis=0) <= high).all()
    ]
    return figures.draw_markings(axes, shown)


def _objects(axes: Axes, content: PlanContent, bbox: Bbox) -> list[figures.Handle]:
    """Draw cones and other objects, and changes. Returns their entries of the legend, with the counts inside the picture."""
    xy_m = np.reshape([mark.xy_m for mark in content.marks], (-1, 2))
    inside = np.asarray(((xy_m >= bbox[:2]) & (xy_m <= bbox[2:])).all(axis=1))
    shown = [content.marks[k] for k in np.flatnonzero(inside).tolist()]
    by_class = any(letter_of(mark.category) for mark in content.marks)
    handles: list[figures.Handle] = []
    for level, (kind, style) in enumerate([(None, content.others), *marks.KIND_MARKS.items()], 4):
        group = [mark for mark in shown if mark.kind is kind]
        places = np.reshape([mark.xy_m for mark in group], (-1, 2))
        classes = [mark.category for mark in group]
        handles[:0] = figures.draw_objects(axes, places, classes, style, by_class=by_class, zorder=level)
    colour = marks.KIND_MARKS[DeltaKind.MOVED].colour
    for mark in shown:
        if mark.old_xy_m is not None:
            x, y = mark.old_xy_m
            axes.scatter(x, y, marker="o", s=26, facecolors="none", edgecolors=colour, linewidths=1.0, zorder=8)
            figures.draw_arrow(
                axes, mark.old_xy_m, mark.xy_m, colour, zorder=8, linewidth=1.2, clip_path=axes.patch, clip_on=True
            )
    labelled = [mark for mark in shown if mark.label]
    for mark in sorted(labelled, key=lambda mark: mark.kind is DeltaKind.CONFIRMED)[:_MAX_LABELS]:
        ink = colour if mark.kind is DeltaKind.MOVED else _INK
        right = not _hides(axes, mark, shown, side=1) or _hides(axes, mark, shown, side=-1)
        text = axes.annotate(
            mark.label, xy=mark.xy_m, xytext=(6 if right else -6, 5), textcoords="offset points",
            fontsize=_LABEL_PT, color=ink, ha="left" if right else "right",
        )  # fmt: skip
        text.set(zorder=14, path_effects=[withStroke(linewidth=2, foreground="white")])
    return handles


def _hides(axes: Axes, mark: PlanMark, others: Sequence[PlanMark], side: int) -> bool:
    """Whether the mark's label, on its right (1) or left (-1), would hide another mark."""
    at_px = axes.transData.transform([one.xy_m for one in (mark, *others)])
    across_pt, up_pt = ((at_px[1:] - at_px[0]) * [side, 1] * 72 / _DPI).T
    return bool(
        ((across_pt > 0) & (across_pt < 0.6 * _LABEL_PT * len(mark.label) + 12) & (up_pt > 0) & (up_pt < 17)).any()
    )


def _frame(axes: Axes) -> None:
    """Round coordinates at the frame."""
    for axis, side in ((axes.xaxis, "E"), (axes.yaxis, "N")):
        axis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10], prune="both"))
        axis.set_major_formatter(
            FuncFormatter(lambda value, _, side=side: f"{value:,.0f} {side}".replace(",", "\u2009"))
        )
    axes.tick_params(labelsize=7, colors=marks.DRIVE_PATH, length=3)
    for label in axes.get_yticklabels():
        label.set(rotation=90, va="center")
    axes.grid(color="#e3e7eb", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[:].set_color("#9aa5b0")


def _scale_bar(axes: Axes, bbox: Bbox) -> None:
    """At the lower left, with a round length of about a fifth of the width."""
    width_m = bbox[2] - bbox[0]
    power = 10.0 ** math.floor(math.log10(width_m / 5))
    length_m = power * max(step for step in (1, 2, 5, 10) if step * power <= width_m / 5)
    style = {"color": _INK, "fontproperties": FontProperties(size=7.5)}
    bar = AnchoredSizeBar(
        axes.transData, length_m, f"{length_m:g} m", "lower left", pad=0.5, sep=3, size_vertical=width_m / 250, **style
    )
    bar.patch.set(edgecolor="none", alpha=0.88)
    bar.set(zorder=12)
    axes.add_artist(bar)


def _north(axes: Axes) -> None:
    """An arrow beside the map, below the legend, where it covers nothing."""
    arrow = axes.annotate(
        "N", xy=(1.06, 0.11), xytext=(1.06, 0.02), xycoords="axes fraction", ha="center", va="center", fontsize=10,
        fontweight="bold", color=_INK, annotation_clip=False, arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.6,
        "mutation_scale": 14},
    )  # fmt: skip
    arrow.set_in_layout(False)
