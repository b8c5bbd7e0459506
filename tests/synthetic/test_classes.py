"""Objects of several classes beside each other: their tracks, and what drives of several days make of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from conetl.geometry.calibration.covariance import unpack_jacobians
from conetl.geometry.packing import cov3, cov_matrix
from conetl.mapping.fusion import fuse
from conetl.mapping.history import DriveEvidence, MapHistory, replay_drives
from conetl.mapping.visibility import check_visibility, observations_of_drive
from conetl.model.detector_evidence import UNMEASURED, AbsenceFigures
from conetl.model.drive import Detection, FramePair, Position, Track
from conetl.model.feature_classes import CONE, FEATURE_CLASSES
from conetl.model.map_records import Decisions, DeltaKind
from conetl.model.params import DetectionParams, IngestParams
from conetl.model.rejections import Rejection
from conetl.model.rig import Side
from conetl.tracking.error_propagation import class_error_id
from tests.synthetic.world import (
    ORIGIN_M,
    START_NS,
    Cone,
    detect,
    evidence_of,
    fuse_logged,
    locate,
    make_path,
    make_rig,
)

RIG, PARAMS = make_rig(), IngestParams()
DAY_NS = 86_400_000_000_000
#: By class: one object each; the sign hangs above the drum.
ROW = [(CONE, Cone((15.0 + 4.0 * k, 2.5, 0.0))) for k in range(4)]
DRUM = ("drum", Cone((35.0, 3.0, 0.0), 0.95, 0.55))
SIGN = ("work_zone_sign", Cone((35.0, 3.05, 1.5), 0.9, 0.8))
BARRICADE = ("barricade", Cone((38.0, -3.0, 0.0), 1.1, 1.6))
Objects = Sequence[tuple[str, Cone]]
Boxes = dict[tuple[int, Side], list[Detection]]


def boxes_of(objects: Objects, pairs: Sequence[FramePair], rng: np.random.Generator) -> Boxes:
    found: Boxes = {(pair.frame_index, side): [] for pair in pairs for side in ("left", "right")}
    for category, body in objects:
        for key, boxes in detect([body], pairs, RIG, noise_px=0.4, rng=rng).items():
            numbered = ({"category": category, "detection_index": len(found[key])} for _ in boxes)
            found[key] += [box.model_copy(update=update) for box, update in zip(boxes, numbered, strict=True)]
    return found


def tracks_of(boxes: Boxes, pairs: Sequence[FramePair]) -> tuple[list[Track], list[Rejection], list[Position]]:
    found, matches, positions = locate(boxes, pairs, RIG)
    return *fuse_logged(pairs, RIG, found, matches, positions, params=PARAMS), positions


def drive(objects: Objects, day: int, categories: Sequence[str] = tuple(FEATURE_CLASSES)) -> DriveEvidence:
    """A drive of this day that searched for some classes."""
    pairs = make_path(40, first_ns=START_NS + day * DAY_NS)
    seen = [one for one in objects if one[0] in categories]
    boxes = boxes_of(seen, pairs, np.random.default_rng(day))
    tracks, _, positions = tracks_of(boxes, pairs)
    figures = AbsenceFigures(evidence=UNMEASURED, score_threshold=0.3, categories=tuple(categories))
    spots = [(p.frame_index, p.category, p.xyz_m) for p in positions]
    view = observations_of_drive(RIG, pairs, [d for some in boxes.values() for d in some], spots, figures)
    return evidence_of(
        f"day {day}", pairs[0].captured_at_ns, tracks, np.array([pair.pose.map_t_body_m[:2] for pair in pairs]),
        check_visibility=lambda f, offset_m, others_m: check_visibility(f, offset_m, others_m, view, PARAMS.reconcile),
    )  # fmt: skip


def standing(history: MapHistory) -> list[tuple[str, int]]:
    """Class and northing in decimetres of what stands at the end."""
    last = [chain[-1] for chain in history.chains.values()]
    return sorted((v.feature.category, round(10 * (v.feature.xyz_m[1] - ORIGIN_M[1]))) for v in last if v.present)


def changes(history: MapHistory, one: DriveEvidence) -> Mapping[str, list[str]]:
    found: dict[str, list[str]] = {}
    for delta in history.updates[one.changeset_id].deltas:
        if delta.kind not in (DeltaKind.CONFIRMED, DeltaKind.MISSED):
            found.setdefault(delta.kind.value, []).append(delta.state_after.category if delta.new else "")
    return found


def test_each_class_has_its_tracks_and_a_sign_may_hang_above_a_drum() -> None:
    pairs, objects = make_path(40), [*ROW, DRUM, SIGN, BARRICADE]
    tracks, rejections, _ = tracks_of(boxes_of(objects, pairs, np.random.default_rng(1)), pairs)
    assert [r.detail for r in rejections if r.reason != "box_cut_by_border"] == []
    expected = sorted((category, *body.foot_m) for category, body in objects)
    found = sorted((track.category, *(np.array(track.xyz_m) - ORIGIN_M)) for track in tracks)
    assert [one[0] for one in found] == [one[0] for one in expected]
    misses_m = np.array([one[1:] for one in found]) - np.array([one[1:] for one in expected])
    # The box of a flat object is that of a round one here: half its width nearer.
    assert np.abs(misses_m[:, 1:]).max() < 0.08
    assert np.abs(misses_m[[one[0] in (CONE, "drum") for one in found], 0]).max() < 0.08


def test_errors_of_a_class_are_stated_apart_and_stay_however_many_drives() -> None:
    """What drums of one drive have in common is part of their covariances, not of that between them. It remains in fusion over
    drives, as the network makes the same errors in each."""
    pairs, others = make_path(40), [*ROW, DRUM]
    tracks, _, _ = tracks_of(boxes_of(others, pairs, np.random.default_rng(1)), pairs)
    drum = next(track for track in tracks if track.category == "drum")
    assert all(track.shared_jacobian is None for track in tracks if track.category == CONE)
    shared = drum.shared_jacobian
    assert shared is not None and shared.calibrations == (class_error_id("drum"),)
    [[moved_m]] = unpack_jacobians(shared.calibrations, [shared])
    common = moved_m @ moved_m.T
    apart = cov_matrix(drum.cov_m2) - cov_matrix(drum.relative_cov_m2) - common
    assert np.trace(common) > 1e-6 and np.linalg.eigvalsh(apart).min() > 0, "the rest is that of the poses"
    cov, jacobian = drum.cov_m2, drum.shared_jacobian
    for _ in range(20):
        _, [cov_m2], [jacobian], _ = fuse([cov], [jacobian], [drum.cov_m2], [drum.shared_jacobian])
        cov = cov3(cov_m2)
    np.testing.assert_allclose(cov_matrix(cov), common + (cov_matrix(drum.cov_m2) - common) / 21, rtol=1e-3, atol=1e-9)


def test_the_class_is_that_of_most_scores() -> None:
    """A detector that calls a drum a cone in a third of the images has seen one drum, not two objects."""
    pairs, rng = make_path(40), np.random.default_rng(2)
    boxes = boxes_of([DRUM], pairs, rng)
    for (frame, _), some in boxes.items():
        if frame % 3 == 0:
            some[:] = [box.model_copy(update={"category": CONE}) for box in some]
    tracks, _, _ = tracks_of(boxes, pairs)
    assert [track.category for track in tracks] == ["drum"]
    assert {frame % 3 for frame, _ in tracks[0].members} == {0, 1, 2}


def test_a_drum_in_the_place_of_a_cone_is_a_new_object() -> None:
    before, after = (
        drive([*ROW, DRUM], 0),
        drive([*ROW[:-1], ("drum", Cone((27.0, 2.5, 0.0), 0.95, 0.55)), DRUM], 1),
    )
    history = replay_drives([before, after], Decisions())
    assert standing(history) == sorted([*((CONE, 25) for _ in ROW[:-1]), ("drum", 25), ("drum", 30)])
    assert changes(history, after) == {"added": ["drum"], "removed": [""]}
    assert standing(replay_drives([after, before], Decisions())) == standing(history), "in any order"


def test_what_a_drive_did_not_search_for_stays() -> None:
    everything, cones_only = drive([*ROW, DRUM, SIGN], 0), drive(ROW, 1, (CONE,))
    history = replay_drives([cones_only, everything], Decisions())
    assert standing(history) == sorted([*((CONE, 25) for _ in ROW), ("drum", 30), ("work_zone_sign", 30)])
    assert changes(history, cones_only) == {}


def test_classes_of_unmeasured_boxes_are_gone_after_several_drives() -> None:
    """Nothing is known of how often a sign is missed: one drive without it is not enough."""
    drives = [drive([*ROW, DRUM, SIGN], 0), *(drive(ROW, day) for day in (1, 2, 3, 4))]
    states = [standing(replay_drives(drives[: n + 1], Decisions())) for n in range(len(drives))]
    assert len(states[1]) == 6, "one drive is not enough"
    assert states[-1] == [(CONE, 25)] * 4
    assert standing(replay_drives(drives[::-1], Decisions())) == states[-1]


def test_unknown_classes_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="bollard: expected some of traffic_cone, tubular_marker"):
        DetectionParams(categories=("bollard",))
    assert DetectionParams(categories=("drum", CONE)).categories == (CONE, "drum"), "one order, because they are hashed"
