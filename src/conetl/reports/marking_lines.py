"""Lane markings on plans: the paint with its dashes where nothing changed, else a line in the colour of the change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from conetl.exports.kind_marks import CASING, KIND_MARKS, PAINT, dashes_of
from conetl.model.map_records import Delta, DeltaKind, FeatureChange, MapFeature
from conetl.model.markings import Marking

Floats = NDArray[np.float64]
_PAINT_PT, _CASING_PT, _CHANGE_PT = 1.3, 2.4, 2.6
#: Of lines that are gone, in units of their width.
_GONE = (0, (1.6, 1.1))
#: Kinds after which a line is drawn as its paint.
_QUIET = (None, DeltaKind.CONFIRMED, DeltaKind.MISSED)


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


def change_of_row(row: Mapping[str, Any]) -> MarkingChange | None:
    """Of a row of `history.changes_of_changeset`; None of a point object."""
    shape, old, kind = row["marking"], row["old_marking"], DeltaKind(row["kind"])
    if shape is None:
        return None
    old_m = np.array(old["line_m"]) if old is not None and kind is DeltaKind.MOVED else None
    return MarkingChange(np.array(shape["line_m"]), shape["colour"], shape["dash_m"], shape["gap_m"], kind, old_m)


def ends_of(changes: Sequence[MarkingChange]) -> Floats:
    """(N, 2): first and last vertices, of the old lines too."""
    lines = [line for change in changes for line in (change.line_m, change.old_line_m) if line is not None]
    return np.array([line[k, :2] for line in lines for k in (0, -1)]).reshape(-1, 2)


def draw_markings(
    axes: Axes, changes: Sequence[MarkingChange], origin_m: Sequence[float] | Floats = (0.0, 0.0)
) -> list[Line2D]:
    """Draw the lines below all objects, (0, 0) of the axes being at `origin_m`; the entries of the legend with their counts."""

    def drawn(lines: Iterable[Floats], colour: str, width_pt: float, **style: object) -> None:
        shifted = [line[:, :2] - np.asarray(origin_m) for line in lines]
        axes.add_collection(LineCollection(shifted, colors=colour, linewidths=width_pt, **style), autolim=False)  # type: ignore[arg-type]

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
