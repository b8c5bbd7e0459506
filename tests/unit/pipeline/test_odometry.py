"""Self-calibration of a drive in chunks, and frames that both cameras lose."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.checks.verdict import judge, judge_all
from conetl.files.parquet_store import load_result
from conetl.geometry.motion.stereo_tracks import StereoTracks, motions_of
from conetl.geometry.packing import vec3
from conetl.geometry.rig import right_camera_turned
from conetl.model.drive import FramePair
from conetl.model.health import Verdict
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.model.rig import SIDES
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline import odometry as steps
from conetl.pipeline.chunks import Chunk, chunks_of, geometry_key, images_key
from conetl.pipeline.odometry import calibration_pieces, grey_reader
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.tracking.checks.exposures import check_lost_frames
from tests.integration.small_drives import SAMPLES
from tests.mutants.recordings import images_shifted
from tests.synthetic.world import make_path, make_rig

#: They would stand in a user's output.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")


@pytest.mark.parametrize(
    ("frames", "named"), [(1, "before frame pair 8:"), (-1, "before frame pair 8:"), (0, "No frame")]
)
def test_a_frame_that_both_cameras_lose_or_repeat_is_found(frames: int, named: str) -> None:
    drive = images_shifted(frames, 8)(read_drive(SAMPLES[0])[0])
    pairs, rig, params = drive.frame_pairs[:13], drive.rig, TrajectoryParams()
    motions = motions_of(follow_drive(pairs, rig, grey_reader(rig), params), pairs, rig, params)
    check = judge(check_lost_frames(pairs, rig, list(motions), grey_reader(rig), params))
    assert named in check.detail and check.verdict is (Verdict.HOLD if frames else Verdict.PASS)


def moved(pairs: Sequence[FramePair], by_m: NDArray[np.float64]) -> list[FramePair]:
    """Frame pairs with other logged positions (K, 3)."""
    places = np.array([pair.pose.map_t_body_m for pair in pairs]) + by_m
    return [pair.with_pose(map_t_body_m=vec3(place)) for pair, place in zip(pairs, places, strict=True)]


def test_a_log_that_scatters_shows_no_lost_frame() -> None:
    """Of 200 logs with white errors of 0.5 m, some of which are as even around some interval as a good one."""
    drive = read_drive(SAMPLES[0])[0]
    pairs, rig, params, random = drive.frame_pairs[:24], drive.rig, TrajectoryParams(), np.random.default_rng(1)
    motions = list(motions_of(follow_drive(pairs, rig, grey_reader(rig), params), pairs, rig, params))
    for _ in range(200):
        logged = moved(pairs, random.normal(0, [0.5, 0.5, 0.1], (len(pairs), 3)))
        check = judge(check_lost_frames(logged, rig, motions, grey_reader(rig), params))
        assert check.verdict is Verdict.PASS, check.detail


def test_images_are_followed_where_the_log_steps() -> None:
    drive = read_drive(SAMPLES[0])[0]
    pairs, rig, params = drive.frame_pairs[:9], drive.rig, TrajectoryParams()
    logged = moved(pairs, np.where(np.arange(len(pairs))[:, None] < 5, 0.0, [2.0, -3.0, 1.0]))
    found = [len(one.points()[0]) for one in follow_drive(logged, rig, grey_reader(rig), params)]
    usual = [len(one.points()[0]) for one in follow_drive(pairs, rig, grey_reader(rig), params)]
    assert min(found) > 0.8 * min(usual)


def test_a_drive_of_which_one_pair_is_left_is_checked() -> None:
    drive = read_drive(SAMPLES[0])[0]
    pairs, rig, params = drive.frame_pairs[:3], drive.rig, IngestParams()
    followed = follow_drive(pairs, rig, grey_reader(rig), params.trajectory)
    motions = list(motions_of(followed, pairs, rig, params.trajectory))
    drive = drive.model_copy(update={"frame_pairs": pairs[:1]})
    refined = steps.refine(drive, motions, [], params)
    checks = judge_all(steps.check_poses(drive, motions, refined, params.trajectory, params.check))
    assert {check.verdict for check in checks} <= {Verdict.PASS}


def test_results_of_images_depend_on_both_images_and_the_rig_alone(tmp_path: Path) -> None:
    (chunk,) = chunks_of(read_drive(SAMPLES[0])[0], Settings(home=tmp_path), IngestParams())
    first, *others = chunk.frame_pairs
    changes = {f"{side}_{what}": "0" * 64 for side in ("left", "right") for what in ("path", "sha256")}
    keys = {
        images_key(chunk.model_copy(update={"frame_pairs": (first.model_copy(update={name: value}), *others)}))
        for name, value in changes.items()
    }
    assert len(keys | {images_key(chunk), images_key(chunk, right_camera_turned(chunk.rig, np.full(3, 1e-4)))}) == 6
    elsewhere = first.model_copy(update={"pose": others[0].pose})
    moved = chunk.model_copy(update={"frame_pairs": (elsewhere, *others)})
    assert images_key(moved) == images_key(chunk) and geometry_key(moved) != geometry_key(chunk)


def test_images_at_the_ends_of_spans_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = read_drive(SAMPLES[0])[0]
    (chunk,) = chunks_of(drive, Settings(home=tmp_path), IngestParams())
    (piece,) = calibration_pieces(chunk, drive.frame_pairs)
    decoded: Counter[tuple[int, str]] = Counter()
    decode = steps.read_pair_image

    def counted(pair: Any, side: Any, *arguments: Any, **options: Any) -> Any:
        decoded[pair.frame_index, side] += 1
        return decode(pair, side, *arguments, **options)

    monkeypatch.setattr(steps, "read_pair_image", counted)
    found, _ = load_result(steps.follow_spans(piece), StereoTracks)
    assert len(found) == 19
    assert set(decoded) == {(index, side) for index in range(0, 39, 2) for side in SIDES} and set(decoded.values()) == {
        1
    }


@pytest.mark.parametrize(("spans", "most", "counts"), [(0, 120, []), (19, 120, [19]), (50, 120, [20, 20, 10]),
                                                       (300, 120, 6 * [20]), (300, 10, [10])])  # fmt: skip
def test_pieces_of_a_drive_hold_all_spans_or_as_many_as_are_compared(
    tmp_path: Path, spans: int, most: int, counts: list[int]
) -> None:
    """Evenly spread, from the first to the last; each has two intervals of 1.1 m."""
    pairs = make_path(2 * spans + 1, 1.1)
    params = IngestParams(trajectory=TrajectoryParams(self_calibration_max_spans=most, self_calibration_span_m=2.0))
    chunk = Chunk(
        drive_id="one",
        rig=make_rig(), frame_pairs=tuple(pairs[:4]), results_folder=tmp_path, model_path=None, detections_sha256="ab",
        params=params,
    )  # fmt: skip
    pieces = calibration_pieces(chunk, pairs)
    assert [(len(piece.frame_pairs) - 1) // 2 for piece in pieces] == counts
    if counts:
        assert pieces[0].frame_pairs[0] is pairs[0]
        assert (pieces[-1].frame_pairs[-1] is pairs[-1]) is (len(counts) > 1 or spans == counts[0])
    found = steps.self_calibrate(chunk, [], [])
    assert found.detail.startswith("kept as given: 0 spans")
