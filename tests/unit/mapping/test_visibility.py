from __future__ import annotations

import math

import numpy as np
import pytest

from conetl.geometry.motion.rolling_shutter import with_shutters
from conetl.mapping import visibility
from conetl.model.detector_evidence import UNMEASURED_ABSENCE, AbsenceFigures, DetectorEvidence
from conetl.model.drive import MIN_DETAIL, Detection, Position, UnclearSquares
from conetl.model.feature_classes import LANE_MARKING
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.rig import Shutter, Side
from conetl.perception.model_card import read_model_card
from tests import records
from tests.synthetic.world import ORIGIN_M, Cone, detect, make_path, make_rig, observe

RIG = make_rig()
PAIRS = make_path(30)
TIMES = {pair.frame_index: pair.captured_at_ns for pair in PAIRS}
PARAMS = ReconcileParams()
NO_OTHERS = np.empty((0, 3))
CONE = Cone((25.0, 2.0, 0.0))


def shipped() -> DetectorEvidence:
    evidence = read_model_card(None).evidence
    assert evidence is not None, "the shipped model's sidecar holds its evidence"
    return evidence


def boxes(cones: list[Cone]) -> list[Detection]:
    sides: tuple[Side, Side] = ("left", "right")
    by_side = detect(cones, PAIRS, RIG)
    return [d for pair in PAIRS for side in sides for d in by_side[pair.frame_index, side]]


def in_view(cone: Cone) -> list[int]:
    drive = observed([])
    rows, heights_px, found = visibility.pairs_in_view(ORIGIN_M + np.array(cone.foot_m), cone.height_m, drive, PARAMS)
    assert heights_px.shape == (len(rows), 2)
    assert len(found) == len(rows)
    return [drive.frames[row] for row in rows]


def absence_with(others: list[Cone]) -> visibility.NotObserved | None:
    """DriveEvidence of absence beside other cones."""
    seen = visibility.observations_of_drive(RIG, PAIRS, boxes(others), [])
    return visibility.check_visibility(feature(CONE), np.zeros(3), NO_OTHERS, seen, PARAMS)


def feature(cone: Cone) -> MapFeature:
    here = records.standing_at(ORIGIN_M + np.array(cone.foot_m), cone.height_m)
    return records.feature(1, seen_ns=1, last_seen_ns=2, **here)


def test_a_cone_ahead_is_in_view_until_it_leaves_the_image() -> None:
    frames = in_view(CONE)
    assert len(frames) > 8
    assert frames == list(range(frames[0], frames[-1] + 1))
    assert frames[-1] < 22, "abeam and behind it is out of view"


def test_small_far_and_sideways_locations_are_not_in_view() -> None:
    assert in_view(Cone((80.0, 0.0, 0.0))) == [f for f in in_view(Cone((80.0, 0.0, 0.0))) if f > 20]
    assert in_view(Cone((10.0, 30.0, 0.0))) == []
    assert in_view(Cone((-10.0, 0.0, 0.0))) == []


def test_a_nearer_cone_weakens_the_evidence_and_a_farther_one_does_not() -> None:
    plain, behind, before = (
        absence_with(others)
        for others in ([], [Cone((23.5, 1.95, 0.0), height_m=0.9, base_m=0.6)], [Cone((30.0, 2.1, 0.0))])
    )
    assert plain is not None
    assert before == plain
    assert behind is None or behind.log_likelihood_ratio > plain.log_likelihood_ratio + 0.5


def test_the_more_and_the_nearer_the_looks_the_surer_is_the_absence_but_never_certain() -> None:
    ratios = []
    for frames in (3, 8, 12, 30):
        drive = visibility.observations_of_drive(
            RIG, PAIRS[:frames], [], [], AbsenceFigures(evidence=shipped(), score_threshold=0.3)
        )
        found = visibility.check_visibility(feature(CONE), np.zeros(3), NO_OTHERS, drive, PARAMS)
        ratios.append(0.0 if found is None else found.log_likelihood_ratio)
    assert ratios == sorted(ratios, reverse=True)
    # A feature of some drives' standing (odds of 9 at most) is then removed; after the three first and smallest views it is at
    # the limit.
    after = [1 / (1 + math.exp(-(math.log(9) + ratio))) for ratio in (ratios[0], ratios[-1])]
    assert PARAMS.removal_existence_probability > after[1] + 0.1
    assert after[0] > after[1] + 0.1
    assert ratios[-1] > math.log(PARAMS.unseen_occluder_probability)


def observed(positions: list[Position]) -> visibility.DriveObservations:
    return visibility.observations_of_drive(RIG, PAIRS, [], [(p.frame_index, p.category, p.xyz_m) for p in positions])


def empty_frames(positions: list[Position], offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> int:
    found = visibility.check_visibility(feature(CONE), np.array(offset_m), NO_OTHERS, observed(positions), PARAMS)
    return 0 if found is None else found.frames


def test_images_without_detail_show_no_absence() -> None:
    """Fog, or a lens that is covered: the first half of the drive."""
    half = len(PAIRS) // 2
    pairs = [pair.model_copy(update={"detail": 0.5 * MIN_DETAIL if k < half else None}) for k, pair in enumerate(PAIRS)]
    drive = visibility.observations_of_drive(RIG, pairs, [], [])
    found = visibility.check_visibility(feature(CONE), np.zeros(3), NO_OTHERS, drive, PARAMS)
    assert (0 if found is None else found.frames) == sum(k >= half for k in in_view(CONE)) > 0


def test_nothing_is_missing_where_a_lens_is_smeared() -> None:
    """Of either camera; the rest of the image says as much as before."""
    rows, columns = range(RIG.left.height_px // 64), range(RIG.left.width_px // 64)
    everywhere = tuple((row, column) for row in rows for column in columns)
    left_edge = tuple((row, 0) for row in rows)
    frames = []
    for side, squares in (("left", everywhere), ("right", everywhere), ("left", left_edge), ("left", ())):
        unclear = UnclearSquares.model_validate({"side_px": 64, side: squares})
        figures = UNMEASURED_ABSENCE.model_copy(update={"unclear": unclear})
        view = visibility.observations_of_drive(RIG, PAIRS, [], [], figures)
        found = visibility.check_visibility(feature(CONE), np.zeros(3), NO_OTHERS, view, PARAMS)
        frames.append(0 if found is None else found.frames)
    assert frames[:2] == [0, 0] and 0 < frames[2] <= frames[3] == empty_frames([])


def test_no_marking_is_missing_where_a_lens_is_smeared() -> None:
    figures = UNMEASURED_ABSENCE.model_copy(update={"categories": (LANE_MARKING,)})
    vertices_m = ORIGIN_M + np.array([[x, 1.0, 0.0] for x in np.arange(10.0, 30.0, 2.0)])

    def seen(unclear: UnclearSquares | None) -> int:
        view = visibility.observations_of_drive(RIG, PAIRS, [], [], figures.model_copy(update={"unclear": unclear}))
        return int(visibility.markings_in_view(vertices_m, view, 0.5, PARAMS).in_view.sum())

    last = RIG.right.height_px // 64 - 1
    lower = tuple((row, column) for row in range(last // 2, last + 1) for column in range(RIG.right.width_px // 64))
    assert seen(None) > 0 and seen(UnclearSquares(side_px=64, right=lower)) == 0


def test_the_offset_of_the_drive_is_added() -> None:
    _, _, positions = observe([CONE], PAIRS, RIG)
    elsewhere = [p.model_copy(update={"xyz_m": (p.xyz_m[0] + 1.2, p.xyz_m[1], p.xyz_m[2])}) for p in positions]
    assert empty_frames(elsewhere) > 5
    assert empty_frames(elsewhere, (1.2, 0.0, 0.0)) == 0


def test_frames_before_the_last_observation_are_ignored() -> None:
    """An overlapping drive observed the cone later."""
    frames = in_view(CONE)
    seen = feature(CONE).model_copy(update={"last_seen_ns": TIMES[frames[3]]})
    found = visibility.check_visibility(seen, np.zeros(3), NO_OTHERS, observed([]), PARAMS)
    assert found is not None
    assert (found.frames, found.first_ns) == (len(frames) - 4, TIMES[frames[4]])
    early = [position for position in observe([CONE], PAIRS, RIG)[2] if position.frame_index < frames[2]]
    found = visibility.check_visibility(feature(CONE), np.zeros(3), NO_OTHERS, observed(early), PARAMS)
    assert found is not None and found.first_ns == TIMES[frames[2]], "the first empty one"


def test_a_neighbour_is_not_taken_for_a_removed_cone() -> None:
    """Cones 0.5 m apart: the observations are of the other one."""
    neighbour = Cone((25.0, 2.45, 0.0))
    _, _, positions = observe([neighbour], PAIRS, RIG)
    alone = visibility.check_visibility(feature(CONE), np.zeros(3), NO_OTHERS, observed(positions), PARAMS)
    assert alone is None
    others = (ORIGIN_M + np.array(neighbour.foot_m))[None]
    known = visibility.check_visibility(feature(CONE), np.zeros(3), others, observed(positions), PARAMS)
    assert known is not None
    assert known.occupied == 0


def test_a_rolling_shutter_sees_a_cone_where_its_row_was_exposed() -> None:
    """At 10 m/s and 20 ms the lowest row is 0.2 m farther along the road than the first one, to which the stamp belongs."""
    shutter = Shutter(readout_ms=20.0, stamp_row="first")
    still, rolling = (
        visibility.observations_of_drive(rig, PAIRS, [], []) for rig in (RIG, with_shutters(RIG, shutter, shutter))
    )
    assert not still.rates
    foot_m = ORIGIN_M + np.array(CONE.foot_m)
    rows, _, at_stamp = visibility.pairs_in_view(foot_m, CONE.height_m, still, PARAMS)
    seen_rows, _, exposed = visibility.pairs_in_view(foot_m, CONE.height_m, rolling, PARAMS)
    assert set(seen_rows.tolist()) <= set(rows.tolist()) and len(seen_rows) >= len(rows) - 1
    for row, (left, right) in zip(seen_rows.tolist(), exposed, strict=True):
        pose = still.map_SE3_left[row]
        depth_m = float((foot_m - pose[:3, 3]) @ pose[:3, 2])
        before = at_stamp[rows.tolist().index(row)][0]
        # The foot is below the camera by a fixed height: its row is inverse to the depth.
        below_px = left[3] - RIG.left.cy_px
        driven_m = 10.0 * 0.02 * left[3] / (RIG.left.height_px - 1)
        assert below_px == pytest.approx((before[3] - RIG.left.cy_px) * depth_m / (depth_m - driven_m), abs=0.3)
        assert right[3] == pytest.approx(left[3], abs=0.1)
    vertices_m = foot_m + np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    figures = UNMEASURED_ABSENCE.model_copy(update={"categories": (LANE_MARKING,)})
    views = [
        visibility.markings_in_view(
            vertices_m, visibility.observations_of_drive(rig, PAIRS, [], [], figures), 1.0, PARAMS
        )
        for rig in (RIG, rolling.rig)
    ]
    assert abs(int(views[0].in_view.sum()) - int(views[1].in_view.sum())) <= 2
