"""Recordings whose poses, clocks or calibration contradict their images: held with their cause named, never believed."""

from __future__ import annotations

import csv
import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import SecretStr

from conetl.checks.verdict import judge_all
from conetl.db.connection import connect, execute
from conetl.db.map.map_store import read_current_features
from conetl.geometry.packing import cov_matrix
from conetl.model.errors import DriveFolderError, MapMismatchError
from conetl.model.health import Verdict, hold_reason
from conetl.model.rejections import RejectionReason
from conetl.perception.checks.stereo_check import check_lost_parts, check_stereo
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.commit import commit
from conetl.pipeline.ingest import ingest
from conetl.pipeline.maps.decisions import accept_drive
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.tracking.checks.mount import STRETCH
from tests.cases import cases
from tests.integration.small_drives import SAMPLES, cut_drive, spoil_huffman_table, unpublished
from tests.mutants import recordings as wrong
from tests.mutants.recorded_analyses import check_as_recorded
from tests.mutants.table import FIRST, RECORDINGS, SECOND, WrongRecording

#: They would stand in a user's output.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
HELD = {recording.name: recording for recording in RECORDINGS if recording.fast}
OFTEN = (
    "GNSS jumps 0.3 m", "GNSS noise 0.3 m", "heights drift 1 m", "poses 10 records late", "poses in reverse", "GNSS frozen",
    "right camera 1 frames late", "images blended with those before",
)  # fmt: skip
#: Causes that the images alone show.
BY_IMAGES = ("covered in part", "shifted sideways", "distorted by k1", "too far to be corrected")
SEEN = [recording for recording in RECORDINGS if recording.cause in BY_IMAGES and SECOND in recording.on]
ONE_OF_EACH_CAUSE = list({recording.cause: recording for recording in reversed(SEEN)}.values())
NAMED = {recording.name: recording for recording in RECORDINGS if FIRST in recording.on}


def against_truth(analysed: AnalysedDrive, folder: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Horizontal errors (m) of the tracks, and their squares by the stated covariances."""
    with (folder / "truth.csv").open() as rows:
        truth = np.array([(float(row["easting_m"]), float(row["northing_m"])) for row in csv.DictReader(rows)])
    xy = np.array([track.xyz_m[:2] for track in analysed.tracks])
    apart = xy[:, None] - truth
    off = apart[np.arange(len(xy)), np.linalg.norm(apart, axis=2).argmin(axis=1)]
    cov = np.array([cov_matrix(track.cov_m2)[:2, :2] for track in analysed.tracks])
    return np.linalg.norm(off, axis=1), np.einsum("ni,nij,nj->n", off, np.linalg.inv(cov), off)


@pytest.mark.parametrize(
    "recording",
    cases(*map(HELD.__getitem__, OFTEN), release=[one for name, one in HELD.items() if name not in OFTEN]),
    ids=lambda recording: recording.name,
)
def test_a_recording_that_contradicts_itself_is_held(
    sample_settings: Settings, tmp_path: Path, recording: WrongRecording
) -> None:
    drive, _ = recording.read(FIRST, tmp_path)
    assert recording.cause is not None
    analysed = analyse(drive, settings=sample_settings)
    assert re.search(recording.cause, hold_reason(analysed.health) or "")
    check_as_recorded(recording.name, analysed)


@pytest.mark.release
def test_images_that_cannot_be_decoded_cost_their_frame_pairs_not_the_drive(
    sample_settings: Settings, tmp_path: Path
) -> None:
    """Visual odometry measures the intervals across them."""
    drive = cut_drive(SAMPLES[0], tmp_path / "drive", "2026-03-02", frames=range(39))
    for side, frame in (("02", 0), ("03", 20), ("02", 38)):
        spoil_huffman_table(drive / f"image_{side}" / "data" / f"{frame:010}.jpg")
    analysed = analyse(read_drive(drive)[0], settings=sample_settings)
    assert len(analysed.drive.frame_pairs) == 36 and hold_reason(analysed.health) is None
    lost = [one for one in analysed.records.rejections if one.reason is RejectionReason.IMAGE_UNREADABLE]
    assert [one.record for one in lost] == ["frame pair 0", "frame pair 20", "frame pair 38"]
    assert "35 of 35 intervals measured" in analysed.trajectory.detail
    errors_m, chi2 = against_truth(analysed, SAMPLES[0])
    assert len(errors_m) == 9 and errors_m.max() < 0.05 and chi2.max() < 18.4


@pytest.mark.release
def test_a_drive_of_which_every_second_image_cannot_be_decoded_is_not_held(
    sample_settings: Settings, tmp_path: Path
) -> None:
    drive = cut_drive(SAMPLES[0], tmp_path / "drive", "2026-03-02", frames=range(39))
    for frame in range(1, 39, 2):
        spoil_huffman_table(drive / "image_02" / "data" / f"{frame:010}.jpg")
    analysed = analyse(read_drive(drive)[0], settings=sample_settings)
    assert hold_reason(analysed.health) is None
    assert "19 of 19 intervals measured" in analysed.trajectory.detail
    errors_m, chi2 = against_truth(analysed, SAMPLES[0])
    assert len(errors_m) == 9 and errors_m.max() < 0.05 and chi2.max() < 18.4


def test_variances_in_place_of_sigmas_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DriveFolderError, match=r"0.0004 m \(median\).* a variance .*horizontal_m: 0.02"):
        NAMED["variances as sigmas"].read(FIRST, tmp_path)


@pytest.mark.parametrize("milliseconds", cases(-100, release=[50, 200]))
def test_an_offset_of_the_clocks_is_found_and_corrected(
    sample_settings: Settings, tmp_path: Path, milliseconds: int
) -> None:
    drive, _ = NAMED[f"clock {milliseconds:+d} ms"].read(SECOND, tmp_path)
    analysed = analyse(drive, settings=sample_settings)
    clock = analysed.trajectory.clock
    assert clock is not None and abs(1e3 * clock.offset_s - milliseconds) < 5.0
    assert hold_reason(analysed.health) is None
    assert Verdict.CORRECTED in {check.verdict for check in analysed.health if check.name.startswith("clock")}
    errors_m, chi2 = against_truth(analysed, SAMPLES[1])
    assert np.median(errors_m) <= 0.03 and chi2.max() < 18.4
    check_as_recorded(f"clock {milliseconds} ms", analysed)


@pytest.mark.release
def test_a_small_offset_of_the_clocks_widens_the_sigmas(sample_settings: Settings, tmp_path: Path) -> None:
    analysed = analyse(NAMED["clock +10 ms"].read(FIRST, tmp_path)[0], settings=sample_settings)
    assert against_truth(analysed, SAMPLES[0])[1].max() < 18.4


@pytest.mark.release
@pytest.mark.parametrize("rows", [3])
def test_right_images_some_rows_off_are_corrected(sample_settings: Settings, tmp_path: Path, rows: int) -> None:
    drive, _ = NAMED[f"right images {rows} rows lower"].read(FIRST, tmp_path)
    analysed = analyse(drive, settings=sample_settings)
    check = next(check for check in analysed.health if check.name.startswith("rows"))
    assert check.verdict is Verdict.CORRECTED and check.value == pytest.approx(rows, abs=0.3)
    assert hold_reason(analysed.health) is None
    assert against_truth(analysed, SAMPLES[0])[1].max() < 18.4
    check_as_recorded(f"right images {rows} rows lower", analysed)


@pytest.mark.release
def test_images_that_were_stretched_vertically_are_named(sample_settings: Settings, tmp_path: Path) -> None:
    [recording] = [one for one in RECORDINGS if "stretched" in one.name and SECOND in one.on]
    checks = analyse(recording.read(SECOND, tmp_path)[0], settings=sample_settings).health
    [check] = [check for check in checks if check.name == STRETCH]
    assert hold_reason(checks) is None
    assert check.verdict is Verdict.NOTE and check.value == pytest.approx(9.1, abs=2.0)
    assert "stretched vertically" in check.detail


def test_the_records_of_the_next_morning_are_not_of_the_drive(tmp_path: Path) -> None:
    drive, rejections = NAMED["drive of the next morning in the same folder"].read(FIRST, tmp_path)
    assert len(drive.frame_pairs) == len(rejections) == 39
    assert all("39 to 77 are of another recording: split" in rejection.detail for rejection in rejections)


@pytest.mark.parametrize(
    "recording",
    cases(*ONE_OF_EACH_CAUSE, release=[one for one in SEEN if one not in ONE_OF_EACH_CAUSE]),
    ids=lambda recording: recording.name,
)
def test_images_alone_show_covered_or_other_lenses_and_shifted_columns(
    tmp_path: Path, recording: WrongRecording
) -> None:
    assert recording.cause is not None
    assert recording.cause in (hold_reason(judge_all(check_stereo(recording.read(SECOND, tmp_path)[0])[1])) or "")


@pytest.mark.parametrize("folder", cases(SAMPLES[0], release=SAMPLES[1:]), ids=lambda folder: folder.name)
def test_good_recordings_pass_and_are_sharp_in_all_parts(sample_settings: Settings, folder: Path) -> None:
    found = analyse(read_drive(folder)[0], settings=sample_settings)
    checks = found.health
    assert checks and found.records.drive.unclear is None
    assert {check.verdict for check in checks} == {Verdict.PASS}, [c for c in checks if c.verdict is not Verdict.PASS]
    check_as_recorded(folder.name, found)


def test_a_part_with_other_right_images_is_found_although_one_interval_could_be_followed() -> None:
    good = read_drive(SAMPLES[1])[0]
    late = wrong.right_late(1, 11, 17)(good)
    lost = [k in (10, 11, 13, 14, 15) for k in range(len(late.frame_pairs) - 1)]
    assert "in frame pairs 12 to 16 belong to left images 1 frames earlier" in str(
        hold_reason(judge_all(check_lost_parts(late, lost)))
    )
    assert check_lost_parts(good, [*lost, False]) == []


def test_a_first_drive_on_hold_does_not_fix_the_crs_of_a_map(database_url: str, sample_settings: Settings) -> None:
    settings = sample_settings.model_copy(update={"database_url": SecretStr(database_url)})
    elsewhere = analyse(wrong.jump(5.0)(read_drive(SAMPLES[1])[0]), settings=settings)
    drive = elsewhere.records.drive.model_copy(update={"map_srid": 32633})
    elsewhere = replace(elsewhere, records=elsewhere.records._replace(drive=drive))
    assert commit(elsewhere, settings).report.on_hold
    assert ingest(SAMPLES[0], settings=settings, publish_new=unpublished).map_srid == 32632
    with closing(connect(database_url)) as conn:
        maps = execute(conn, "select map_name, srid from conetl.map order by 1")
        assert [m["srid"] for m in maps] == [32632, 32633] and maps[1]["map_name"].startswith("default-held-32633-")
    with pytest.raises(MapMismatchError, match="swapped, or in radians"):
        commit(elsewhere, settings)


@pytest.mark.release
def test_a_drive_far_aside_is_known_by_the_arrangement_of_its_cones(
    database_url: str, sample_settings: Settings
) -> None:
    """Beyond all that the comparison with the map has in view. A person may accept it: there are two zones of one plan."""
    settings = sample_settings.model_copy(update={"database_url": SecretStr(database_url)})
    assert ingest(SAMPLES[0], settings=settings, publish_new=unpublished).counts_on_map
    done = commit(analyse(wrong.aside(86.0)(read_drive(SAMPLES[1])[0]), settings=settings), settings).report
    assert "86.0 m from those of the map" in str(done.on_hold)
    assert "the same cones elsewhere" in [check.name for check in done.health if check.verdict is Verdict.HOLD]
    with closing(connect(database_url)) as conn:
        assert len(read_current_features(conn)) == 9
        accept_drive(conn, SAMPLES[1].name, map_name="default")
        assert len(read_current_features(conn)) == 19


@pytest.mark.release
def test_a_drive_with_images_of_another_one_counts_once_a_person_accepts_it(
    database_url: str, sample_settings: Settings, tmp_path: Path
) -> None:
    settings = sample_settings.model_copy(update={"database_url": SecretStr(database_url)})
    drive, _ = NAMED["10 image pairs of another drive"].read(FIRST, tmp_path)
    done = commit(analyse(drive, settings=settings), settings).report
    assert "images of one recording" in [check.name for check in done.health if check.verdict is Verdict.HOLD]
    assert "the images jump" in str(done.on_hold)
    with closing(connect(database_url)) as conn:
        assert not read_current_features(conn)
        accept_drive(conn, drive.drive_id, map_name="default")
        assert len(read_current_features(conn)) >= 9
