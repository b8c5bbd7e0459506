"""Colours of cones and base layers in images, reports and exports, the same as in `conetl view`; marker and text of each kind.

The colours are safe for the colour-blind (no red beside green, no orange), and each kind has a shape of its own. A test
compares them with web/src/kinds.ts and theme.ts.
"""

from __future__ import annotations

from typing import NamedTuple

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
    DeltaKind.ADDED: KindMark("P", "#002e9a", "new"),
}
STANDING = KIND_MARKS[DeltaKind.CONFIRMED]._replace(label="standing")
#: Muted, so that cones come first: LiDAR points of low and of high intensity, lane boundaries, drive paths.
DARK_POINT, BRIGHT_POINT, LANE, DRIVE_PATH = "#a9a294", "#dcd7cc", "#8a7443", "#4a5560"
