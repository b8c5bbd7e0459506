"""Colours of cones, lane markings and base layers in images, reports and exports, the same as in `conetl view`; marker and text
of each kind.

The colours are safe for the colour-blind (no red beside green, no orange), and each kind has a shape of its own. A test
compares them with web/src/kinds.ts, markings.ts and theme.ts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from conetl.model.arrays import Floats
from conetl.model.map_records import DeltaKind


class KindMark(NamedTuple):
    """A marker of matplotlib, a colour as #rrggbb, and the text of the legend."""

    marker: str
    colour: str
    label: str


#: In the order of drawing: later ones are drawn over earlier ones.
KIND_MARKS = {
    DeltaKind.CONFIRMED: KindMark("o", "#7c93a2", "confirmed"),
    DeltaKind.MISSED: KindMark("$\\circ$", "#8a54e4", "not observed"),
    DeltaKind.HEIGHT_CHANGED: KindMark("s", "#006a54", "height changed"),
    DeltaKind.MERGED: KindMark("v", "#1f2933", "merged"),
    DeltaKind.REMOVED: KindMark("X", "#1f2933", "removed"),
    DeltaKind.MOVED: KindMark("D", "#821773", "moved"),
    DeltaKind.SPLIT: KindMark("^", "#002e9a", "split off"),
    DeltaKind.ADDED: KindMark("P", "#002e9a", "added"),
}


def kind_label(kind: str) -> str:
    """The name of a kind of change for people: `not observed` for `missed`."""
    return KIND_MARKS[DeltaKind(kind)].label


def kinds_text(counts: Mapping[DeltaKind, int]) -> str:
    """The kinds that there are, in words: `2 added, 1 not observed`."""
    return ", ".join(f"{counts[kind]} {kind_label(kind)}" for kind in DeltaKind if counts.get(kind))


STANDING = KIND_MARKS[DeltaKind.CONFIRMED]._replace(colour="#d64f00", label="standing")
#: Muted, so that cones come first: LiDAR points of low and of high intensity, lane boundaries, drive paths.
DARK_POINT, BRIGHT_POINT, LANE, DRIVE_PATH = "#a9a294", "#dcd7cc", "#8a7443", "#4a5560"
#: #rrggbb of the paint by `Marking.colour`.
PAINT = {"white": "#ffffff", "yellow": "#f2b705", "other": "#9aa5b0"}
#: Around the paint, so that white is visible on white paper.
CASING = "#4a5560"


def dashes_of(vertices_m: ArrayLike, dash_m: float | None, gap_m: float | None) -> list[Floats]:
    """The painted parts of a lane marking (N, 2 or 3); one part for solid lines (dash_m and gap_m None).

    The position of the dashes along the road is unknown: one dash is centred on the middle of the line.
    """
    line = np.asarray(vertices_m, np.float64)
    if dash_m is None or gap_m is None:
        return [line]
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    length_m, period_m = station[-1], dash_m + gap_m
    first = (length_m / 2 - dash_m / 2) % period_m - period_m
    parts = []
    for start in np.arange(first, length_m, period_m):
        low, high = max(start, 0.0), min(start + dash_m, length_m)
        if low < high:
            at = np.concatenate([[low], station[(station > low) & (station < high)], [high]])
            parts.append(np.stack([np.interp(at, station, axis) for axis in line.T], axis=1))
    return parts
