"""The map picture: content, positions and colours; and that nothing is half-written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from conetl.exports.kind_marks import KIND_MARKS
from conetl.exports.kind_marks import STANDING as STANDING_MARK
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE, FEATURE_CLASSES, LINE_CLASSES, letter_of
from conetl.model.map_records import DeltaKind, FeatureChange
from conetl.reports.figures import NOT_EVALUATED, PlanMark, changes_of, marks_of, save_figure
from conetl.reports.map_picture import PlanContent, draw_plan

ADDED, MOVED, REMOVED, UNCHANGED, LANE = map(bytes.fromhex, ("002e9a", "821773", "1f2933", "7c93a2", "8a7443"))
STANDING = bytes.fromhex("d64f00")
INK = bytes.fromhex("1d2733")
NO_POINTS = (np.empty((0, 2)), np.empty(0, np.uint8))


def cone(samples, name, east_m, north_m, version=1):
    return samples.feature(name, version=version, xyz_m=(458_000.0 + east_m, 5_428_000.0 + north_m, 114.5))


def change(kind, old, new, shift_m=None):
    one = new or old
    where = {"changed_at": None, "changeset_no": 1, "drive_id": "a"}
    return FeatureChange(kind=kind, feature_id=one.feature_id, old=old, new=new, shift_m=shift_m, **where)


def content(standing, changes=None, lines=(), points=NO_POINTS):
    changed = {one.feature_id for one in changes or ()}
    shown = changes or (), [feature for feature in standing if feature.feature_id not in changed]
    return PlanContent(
        32632, marks_of(*shown), changes_of(*shown), [np.array([[458_000.0, 5_428_000.0], [458_030.0, 5_428_000.0]])],
        boundaries_m=list(lines), points_m=points[0], shades=points[1],
        others=STANDING_MARK if changes is None else KIND_MARKS[DeltaKind.CONFIRMED]._replace(label="unchanged"),
    )  # fmt: skip


def pixels(path: Path, colour) -> np.ndarray:
    """(N, 2) column, row of the pixels of a colour, left of the legend."""
    image = cv2.imread(str(path))[:, :, ::-1].astype(int)
    rows, columns = np.nonzero(np.abs(image - list(colour)).max(axis=2) <= 4)
    keep = columns < 0.78 * image.shape[1]
    return np.column_stack([columns[keep], rows[keep]])


def draw(path, made, bbox=None):
    figure = draw_plan(made, bbox=bbox or made._replace(paths_m=()).extent(), title="A road", footer="now")
    return save_figure(figure, path)


def test_changes_are_where_they_belong_in_the_colours_of_the_view(samples, tmp_path):
    same = [cone(samples, "a", 0, 0), cone(samples, "e", 5, 12)]
    moved, added = cone(samples, "b", 10, 8, version=2), cone(samples, "d", 30, 0)
    changes = [
        change("moved", cone(samples, "b", 10, 5), moved, 3.0),
        change("removed", cone(samples, "c", 20, 10), None),
        change("added", None, added),
    ]
    lane_m = np.array([[458_000.0, 5_428_014.0], [458_030.0, 5_428_014.0]])
    made = content([*same, moved, added], changes, lines=[lane_m])
    path = draw(tmp_path / "new folder" / "map.png", made)
    places = {name: pixels(path, colour).mean(axis=0) for name, colour in (("d", ADDED), ("a", UNCHANGED))}
    assert places["d"][0] - places["a"][0] > 300  # 30 m east against the middle of a and e
    assert len(pixels(path, MOVED)) > 100 and len(pixels(path, REMOVED)) > 100
    lane = pixels(path, LANE)
    assert np.ptp(lane[:, 0]) > 800 and np.ptp(lane[:, 1]) < 12
    # the same scale both ways: the lane is 30 m long and lies 14 m above the cone d
    px_per_m = np.ptp(lane[:, 0]) / 30
    assert (places["d"][1] - lane[:, 1].mean()) / px_per_m == pytest.approx(14.0, abs=0.4)


def test_points_are_drawn_below_and_the_outside_is_left_out(samples, tmp_path):
    rng = np.random.default_rng(0)
    points = (np.add(rng.uniform(-40, 40, (5_000, 2)), (458_010.0, 5_428_010.0)), np.full(5_000, 0, np.uint8))
    made = content([cone(samples, "a", 0, 0), cone(samples, "far", 5_000, 0)], points=points)
    path = draw(tmp_path / "map.png", made, (457_980.0, 5_427_980.0, 458_040.0, 5_428_030.0))
    assert len(pixels(path, bytes.fromhex("a9a294"))) > 1_000
    standing = pixels(path, STANDING)
    assert len(standing) > 60 and np.ptp(standing[:, 0]) < 40  # the far one is not there


def test_each_class_has_its_letter_and_its_line_in_the_legend(samples, tmp_path):
    def one(name, category, east_m):
        return cone(samples, name, east_m, 0).model_copy(update={"category": category})

    before = [one("a", "traffic_cone", 0), one("b", "drum", 10)]
    new = [one("c", "traffic_sign", 20), one("d", "bollard", 30), one("e", "traffic_sign", 5_000)]
    made = content([*before, *new], [change("added", None, feature) for feature in new])
    bbox = (457_990.0, 5_427_990.0, 458_040.0, 5_428_020.0)
    path = draw(tmp_path / "map.png", made, bbox)
    for colour, letters in ((UNCHANGED, [False, True]), (ADDED, [True, True])):
        symbols = pixels(path, colour)
        groups = np.split(symbols[np.argsort(symbols[:, 0])], 1 + np.flatnonzero(np.diff(np.sort(symbols[:, 0])) > 50))
        assert len(groups) == 2
        for group, has_letter in zip(groups, letters, strict=True):
            ink = pixels(path, INK) - group.mean(axis=0)
            beside = (ink[:, 0] < 0) & (ink[:, 0] > -40) & (np.abs(ink[:, 1]) < 12)
            assert (np.count_nonzero(beside) > 20) == has_letter
    text = draw(tmp_path / "map.svg", made, bbox).read_text()
    for entry in ("cone, unchanged (1)", "drum, unchanged (1)", "traffic sign, added (1)", "bollard, added (1)"):
        assert text.count(f"<!-- {entry} -->") == 1


def test_the_plan_of_a_drive_tells_classes_apart():
    marks = [
        PlanMark("traffic_cone", DeltaKind.ADDED, (0.0, 0.0)),
        PlanMark("traffic_cone", DeltaKind.MOVED, (5.0, 0.0), (5.0, 1.0), "1.00 m"),
        PlanMark("work_zone_sign", DeltaKind.ADDED, (9.0, 3.0)),
        PlanMark("work_zone_sign", None, (12.0, 3.0)),
    ]

    def legend(*shown):
        path_m = np.array([[0.0, -3.0], [12.0, -3.0]])
        figure = draw_plan(PlanContent(32632, shown, [], [path_m], others=NOT_EVALUATED))
        return [text.get_text() for text in figure.legends[0].get_texts()]

    assert legend(*marks) == [
        "cone, added (1)", "work zone sign, added (1)", "cone, moved (1)", "work zone sign, not evaluated (1)", "drive path",
    ]  # fmt: skip
    assert legend(*marks[:2]) == ["added (1)", "moved (1)", "drive path"]


@pytest.mark.parametrize(("neighbours", "side"), [
    ([], "left"), ([(11.2, 10.5)], "right"), ([(11.2, 10.5), (8.8, 10.5)], "left"), ([(11.2, 9.0)], "left"),
])  # fmt: skip
def test_a_label_is_on_the_side_where_it_hides_no_neighbour(neighbours, side):
    moved = PlanMark("traffic_cone", DeltaKind.MOVED, (10.0, 10.0), (9.5, 9.0), "1.12 m")
    others = [PlanMark("traffic_cone", DeltaKind.CONFIRMED, xy_m) for xy_m in [(0.0, 0.0), (20.0, 20.0), *neighbours]]
    figure = draw_plan(PlanContent(32632, [moved, *others], []))
    [label] = [text for text in figure.axes[0].texts if text.get_text() == "1.12 m"]
    assert label.get_ha() == side


def test_every_class_of_points_but_cones_has_a_letter_of_its_own():
    letters = {name: one.letter for name, one in FEATURE_CLASSES.items() if name not in (CONE, *LINE_CLASSES)}
    assert all(len(letter) == 1 for letter in letters.values()) and len(set(letters.values())) == len(letters)
    assert not letter_of(CONE) and letter_of("bollard") == "?"


@pytest.mark.parametrize(("suffix", "begin"), [(".svg", b"<?xml"), (".pdf", b"%PDF")])
def test_vector_formats(samples, tmp_path, suffix, begin):
    path = draw(tmp_path / f"map{suffix}", content([cone(samples, "a", 0, 0)]))
    assert path.read_bytes().startswith(begin)


def test_what_cannot_be_drawn_or_written_is_refused(samples, tmp_path):
    with pytest.raises(InputError, match="the map has no cones"):
        content([])._replace(paths_m=()).extent()
    one = content([cone(samples, "a", 0, 0)])
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot be written"):
        draw(tmp_path / "file" / "map.png", one)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]
