"""Images, exports and the web view show a kind of change alike."""

from __future__ import annotations

import re
from pathlib import Path

from conetl.exports.kind_marks import KIND_MARKS, STANDING
from conetl.model.map_records import DeltaKind

KINDS_TS = Path(__file__).resolve().parents[3] / "web" / "src" / "kinds.ts"


def test_colours_and_words_are_those_of_the_web_view() -> None:
    styles = re.findall(
        r"^  (\w+): { colour: \"(#[0-9a-f]{6})\", shape: \d, label: \"([^\"]+)\" },$", KINDS_TS.read_text(), re.M
    )
    shown = {kind: (colour, word) for kind, colour, word in styles}
    assert {kind.value: (mark.colour, mark.word) for kind, mark in KIND_MARKS.items()} == {
        kind.value: shown[kind.value] for kind in DeltaKind
    }
    assert (STANDING.colour, STANDING.word) == shown["standing"]


def test_kinds_of_one_colour_have_shapes_of_their_own() -> None:
    assert len({mark[:2] for mark in KIND_MARKS.values()}) == len(KIND_MARKS)
    assert len({mark.marker for mark in KIND_MARKS.values()}) == len(KIND_MARKS)
