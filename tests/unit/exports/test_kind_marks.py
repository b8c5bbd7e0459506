"""Images, exports and the web view share colours and labels."""

from __future__ import annotations

import re
from pathlib import Path

from conetl.exports import qgis_project
from conetl.exports.kind_marks import BRIGHT_POINT, DARK_POINT, DRIVE_PATH, KIND_MARKS, LANE, STANDING
from conetl.model.map_records import DeltaKind

WEB = Path(__file__).resolve().parents[3] / "web" / "src"
KINDS_TS = WEB / "kinds.ts"


def test_colours_and_labels_equal_those_of_the_web_view() -> None:
    styles = re.findall(
        r"^  (\w+): { colour: \"(#[0-9a-f]{6})\", dark: \"#[0-9a-f]{6}\", shape: \d, label: \"([^\"]+)\" },$",
        KINDS_TS.read_text(),
        re.M,
    )
    shown = {kind: (colour, word) for kind, colour, word in styles}
    assert {kind.value: (mark.colour, mark.label) for kind, mark in KIND_MARKS.items()} == {
        kind.value: shown[kind.value] for kind in DeltaKind
    }
    assert (STANDING.colour, STANDING.label) == shown["standing"]


def test_base_layers_have_the_colours_of_the_web_view() -> None:
    light = re.search(r"^  light: {(.*?)^  },", (WEB / "theme.ts").read_text(), re.M | re.S)
    shown = dict(re.findall(r"(\w+): \"(#[0-9a-f]{6})\"", light[1] if light else ""))
    assert [shown[name] for name in ("dark", "bright", "line", "path")] == [DARK_POINT, BRIGHT_POINT, LANE, DRIVE_PATH]
    swatches = dict(
        re.findall(r"--(points|lines): (#[0-9a-f]{6})", (WEB / "tools.css").read_text().partition("[data-theme")[0])
    )
    assert swatches == {"points": DARK_POINT, "lines": LANE}


def test_every_kind_has_a_marker_and_a_qgis_symbol() -> None:
    assert set(qgis_project._KINDS) == set(DeltaKind) - {DeltaKind.MISSED}  # which makes no version
    assert len({mark[:2] for mark in KIND_MARKS.values()}) == len(KIND_MARKS)
    assert len({mark.marker for mark in KIND_MARKS.values()}) == len(KIND_MARKS)
