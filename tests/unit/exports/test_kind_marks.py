"""Images, exports and the web view share colours and labels."""

from __future__ import annotations

import re
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from conetl.exports import qgis_project
from conetl.exports.kind_marks import BRIGHT_POINT, DARK_POINT, DRIVE_PATH, KIND_MARKS, LANE, PAINT, STANDING, dashes_of
from conetl.model.feature_classes import CONE, FEATURE_CLASSES
from conetl.model.map_records import DeltaKind
from tests.folders import ROOT

WEB = ROOT / "web" / "src"
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


def test_the_web_view_knows_every_class_and_its_width() -> None:
    rows = re.findall(r"^  \[\"?(\w+)\"?, { label: .*?, width: ([\d.]+)", (WEB / "classes.ts").read_text(), re.M)
    assert [CONE, *(name for name, _ in rows[1:])] == list(FEATURE_CLASSES)
    assert [float(width) for _, width in rows] == [one.width_over_height for one in FEATURE_CLASSES.values()]


def test_base_layers_have_the_colours_of_the_web_view() -> None:
    light = re.search(r"^  light: {(.*?)^  },", (WEB / "theme.ts").read_text(), re.M | re.S)
    shown = dict(re.findall(r"(\w+): \"(#[0-9a-f]{6})\"", light[1] if light else ""))
    assert [shown[name] for name in ("dark", "bright", "line", "path")] == [DARK_POINT, BRIGHT_POINT, LANE, DRIVE_PATH]


def test_lane_markings_have_the_colours_of_the_web_view() -> None:
    [shown] = re.findall(r"^export const PAINT: .*? = {(.*?)};$", (WEB / "markings.ts").read_text(), re.M)
    assert dict(re.findall(r"(\w+): \"(#[0-9a-f]{6})\"", shown)) == PAINT


#: Of normal and of protanopic, deuteranopic and tritanopic sight (Machado et al. 2009), on linear RGB.
SIGHTS = (
    np.eye(3),
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
)
XYZ_OF_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def luv(colour: str, sight: Any) -> np.ndarray:
    """CIE 1976 L*u*v* of #rrggbb, as a person sees it."""
    rgb = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    x, y, z = XYZ_OF_RGB @ np.clip(np.array(sight) @ linear, 1e-6, 1)
    lightness = 116 * np.cbrt(y) - 16 if y > 0.008856 else 903.3 * y
    return lightness * np.array([1, *13 * (np.array([4 * x, 9 * y]) / (x + 15 * y + 3 * z) - (0.19784, 0.46834))])


@pytest.mark.parametrize("theme", ["colour", "dark"])
def test_colours_differ_in_every_kind_of_sight(theme: str) -> None:
    """A colour difference of 20 is far beyond what is just noticed (1 to 2)."""
    kinds = "added|moved|removed|height_changed|missed|confirmed"
    mine = set(re.findall(rf"^  (?:{kinds}): {{.*?{theme}: \"(#[0-9a-f]{{6}})\"", KINDS_TS.read_text(), re.M))
    assert len(mine) == 6
    near = {
        (a, b): min(float(np.linalg.norm(luv(a, sight) - luv(b, sight))) for sight in SIGHTS)
        for a, b in combinations(sorted(mine), 2)
    }
    assert min(near.values()) > 20, sorted(near.items(), key=lambda item: item[1])[:3]


def test_every_kind_has_a_marker_and_a_qgis_symbol() -> None:
    assert set(qgis_project._KINDS) == {kind for kind in DeltaKind if not kind.ends}
    assert len({mark[:2] for mark in KIND_MARKS.values()}) == len(KIND_MARKS)
    assert len({mark.marker for mark in KIND_MARKS.values()}) == len(KIND_MARKS)


@pytest.mark.parametrize("length_m", [2.0, 20.0, 37.5])
def test_one_dash_is_centred_on_the_middle_of_the_line(length_m: float) -> None:
    parts = dashes_of([[0.0, 0.0], [0.0, length_m]], 3.0, 9.0)
    at = np.linspace(0.0, length_m, 1001)
    painted = np.any([(part[0, 1] <= at) & (at <= part[-1, 1]) for part in parts], axis=0)
    from_middle = np.abs((at - length_m / 2 + 6.0) % 12.0 - 6.0)
    sure = np.abs(from_middle - 1.5) > 1e-6
    assert (painted == (from_middle < 1.5))[sure].all()
