"""How each kind of change looks in images and exports: the colours, words and, as near as can be, shapes of `conetl view`.

The colour-blind can tell the colours apart (no red beside green, no orange), and each kind has a shape of its own as well. A test
holds them against web/src/kinds.ts.
"""

from __future__ import annotations

from typing import NamedTuple

from conetl.model.map_records import DeltaKind


class KindMark(NamedTuple):
    """Marker of matplotlib, colour as #rrggbb, and the word for a legend."""

    marker: str
    colour: str
    word: str


#: In the order of drawing: later ones lie on top.
KIND_MARKS = {
    DeltaKind.CONFIRMED: KindMark("o", "#7f97b2", "confirmed"),
    DeltaKind.MISSED: KindMark("$\\circ$", "#5f45b8", "looked for in vain"),
    DeltaKind.HEIGHT_CHANGED: KindMark("s", "#00707c", "height changed"),
    DeltaKind.MERGED: KindMark("v", "#1f2933", "merged"),
    DeltaKind.REMOVED: KindMark("X", "#1f2933", "removed"),
    DeltaKind.MOVED: KindMark("D", "#a8327f", "moved"),
    DeltaKind.SPLIT: KindMark("^", "#0068b4", "split off"),
    DeltaKind.ADDED: KindMark("P", "#0068b4", "new"),
}
STANDING = KIND_MARKS[DeltaKind.CONFIRMED]._replace(word="standing")
