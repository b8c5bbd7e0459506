"""KITTI drive folders made of small images: whole, and broken in every way that must cost one pair or the drive."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conetl.geometry import geodesy
from conetl.model.drive import Drive, Pose
from conetl.model.errors import DriveFolderError
from conetl.model.rejections import RejectionReason
from conetl.readers.drives import kitti, read_drive
from conetl.readers.drives.drive_yaml import Sigmas
from conetl.readers.drives.header import read_header
from conetl.readers.trajectories.oxts import OxtsRecord
from conetl.readers.trajectories.times import misplaced, parse_timestamp
from tests.prepared import prepared

FRAMES = 6
WIDTH, HEIGHT = 96, 32
LAT, LON = 49.011, 11.5
SPEED_M_S = 10.0
YAW = 0.3

CALIBRATION = {
    "calib_cam_to_cam.txt": f"""calib_time: 09-Jan-2012 13:57:47
S_rect_02: {WIDTH} {HEIGHT}
S_rect_03: {WIDTH} {HEIGHT}
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_02: 60 0 48 3 0 60 16 0.02 0 0 1 0.003
P_rect_03: 60 0 48 -29 0 60 16 0.15 0 0 1 0.003
""",
    "calib_velo_to_cam.txt": "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n",
    "calib_imu_to_velo.txt": "R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.80\n",
}


def stamp(seconds: float) -> str:
    return f"2026-03-01 12:00:{seconds:012.9f}"


def oxts_line(metres: float, *, yaw: float = YAW, accuracy: float = 0.3) -> str:
    """A record `metres` along the heading (yaw counted from true east)."""
    lat = LAT + math.degrees(metres * math.sin(yaw) / 6.371e6)
    lon = LON + math.degrees(metres * math.cos(yaw) / 6.371e6 / math.cos(math.radians(LAT)))
    values = [lat, lon, 120.0 + 0.01 * metres, 0.01, -0.02, yaw] + [0.0] * 17 + [accuracy, 0.03, 4, 8, 4, 4, 6]
    return " ".join(f"{value:.12g}" for value in values)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Six pairs, 10 Hz, 10 m/s; poses are stamped 40 ms after the images. Calibration in the parent folder."""
    root = tmp_path / "day" / "drive_0001"
    rng = np.random.default_rng(0)
    for camera in ("image_02", "image_03"):
        (root / camera / "data").mkdir(parents=True)
        for i in range(FRAMES):
            image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
            assert cv2.imwrite(str(root / camera / "data" / f"{i:010d}.jpg"), image)
        (root / camera / "timestamps.txt").write_text("".join(f"{stamp(1 + 0.1 * i)}\n" for i in range(FRAMES)))
    (root / "oxts" / "data").mkdir(parents=True)
    for i in range(FRAMES):
        (root / "oxts" / "data" / f"{i:010d}.txt").write_text(oxts_line(SPEED_M_S * (0.1 * i + 0.04)) + "\n")
    (root / "oxts" / "timestamps.txt").write_text("".join(f"{stamp(1.04 + 0.1 * i)}\n" for i in range(FRAMES)))
    for name, text in CALIBRATION.items():
        (root.parent / name).write_text(text)
    return root


def numbers(drive: Drive) -> list[int]:
    return [pair.frame_index for pair in drive.frame_pairs]


def test_a_whole_drive_is_read(drive: Path) -> None:
    result, rejections = read_drive(drive)
    assert rejections == []
    assert numbers(result) == list(range(FRAMES))
    assert result.drive_id == "drive_0001"
    assert result.expected_frame_count == FRAMES
    assert result.map_srid == 32632
    assert result.frame_pairs[3].captured_at_ns == 1_772_366_401_300_000_000
    assert Path(result.frame_pairs[3].right_path) == drive.resolve() / "image_03/data/0000000003.jpg"
    assert result.frame_pairs[0].pose.sigma_enu_m == (0.3, 0.3, pytest.approx(0.45))
    assert Drive.model_validate_json(result.model_dump_json()) == result


def test_poses_are_those_of_the_exposure_and_of_grid_north(drive: Path) -> None:
    result, _ = read_drive(drive)
    start = geodesy.to_map(32632, LAT, LON, 120.0)
    convergence = float(geodesy.grid_convergence_rad(32632, LAT, LON))
    assert convergence > math.radians(1.5)
    for pair in result.frame_pairs:  # the first one too, before the first pose: the motion is extrapolated
        moved = np.array(pair.pose.map_t_body_m) - start
        if pair.frame_index == 0:
            assert np.linalg.norm(moved) < 0.01
            continue
        expected = SPEED_M_S * 0.1 * pair.frame_index  # at the image's time, not 40 ms later
        assert np.linalg.norm(moved[:2]) == pytest.approx(expected, rel=0.01)
        assert moved[2] == pytest.approx(0.01 * expected, abs=1e-6)
        yaw, pitch, roll = Rotation.from_matrix(pair.pose.map_R_body).as_euler("ZYX")
        assert (roll, pitch) == (pytest.approx(0.01), pytest.approx(-0.02))
        assert yaw == pytest.approx(YAW + convergence, abs=1e-6)
        # The vehicle drives along its heading: only true with the right sign of the convergence.
        assert math.atan2(moved[1], moved[0]) == pytest.approx(yaw, abs=5e-3)


def test_without_pose_times_the_number_links_them(drive: Path) -> None:
    (drive / "oxts" / "timestamps.txt").unlink()
    result, _ = read_drive(drive)
    moved = np.array(result.frame_pairs[2].pose.map_t_body_m) - geodesy.to_map(32632, LAT, LON, 120.0)
    assert np.linalg.norm(moved[:2]) == pytest.approx(2.4, rel=0.01)


def test_numbers_link_files_not_their_order(drive: Path) -> None:
    for path in ("image_02/data/0000000001.jpg", "image_03/data/0000000001.jpg", "oxts/data/0000000001.txt"):
        (drive / path).unlink()
    whole_before, _ = read_drive(drive)
    assert numbers(whole_before) == [0, 2, 3, 4, 5]
    assert whole_before.expected_frame_count == 5
    assert whole_before.frame_pairs[1].captured_at_ns == 1_772_366_401_200_000_000
    moved = np.array(whole_before.frame_pairs[2].pose.map_t_body_m) - geodesy.to_map(32632, LAT, LON, 120.0)
    assert np.linalg.norm(moved[:2]) == pytest.approx(3.0, rel=0.01)


def test_right_stamps_are_optional_and_change_the_hash_only_where_they_cost_a_pair(drive: Path) -> None:
    whole = read_drive(drive)[0].content_sha256
    change_line(3, stamp(1.31), "image_03")(drive)
    late, rejections = read_drive(drive)
    assert (len(rejections), late.content_sha256 != whole) == (1, True)
    (drive / "drive.yaml").write_text("pair_tolerance_ms: 11\n")
    assert read_drive(drive)[1] == []
    (drive / "drive.yaml").unlink()
    (drive / "image_03/timestamps.txt").unlink()
    assert read_drive(drive)[0].content_sha256 == whole


def test_png_and_jpg_and_short_numbers_mix(drive: Path) -> None:
    data = drive / "image_02" / "data"
    cv2.imwrite(str(data / "2.png"), cv2.imread(str(data / "0000000002.jpg")))
    (data / "0000000002.jpg").unlink()
    (data / "._0000000003.jpg").write_bytes(b"what a file manager leaves behind")
    result, rejections = read_drive(drive)
    assert rejections == []
    assert result.frame_pairs[2].left_path.endswith("2.png")


# --------------------------------------------------------------------------- one pair lost


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


@prepared
def change_oxts(drive: Path, number: int, field: int, value: str) -> None:
    path = drive / "oxts" / "data" / f"{number:010d}.txt"
    words = path.read_text().split()
    words[field] = value
    path.write_text(" ".join(words))


@prepared
def change_line(drive: Path, number: int, text: str, camera: str = "image_02") -> None:
    path = drive / camera / "timestamps.txt"
    lines = path.read_text().splitlines()
    lines[number] = text
    path.write_text("\n".join(lines) + "\n")


@prepared
def replaced(drive: Path, name: str, make: Callable[[Path], object]) -> None:
    (drive / name).unlink()
    make(drive / name)


def link_to_nothing(path: Path) -> None:
    path.symlink_to("/nowhere")


R = RejectionReason
LOSSES: dict[str, tuple[Callable[[Path], object], int, RejectionReason, str]] = {
    "empty file": (lambda d: (d / "image_03/data/0000000001.jpg").write_bytes(b""), 1, R.IMAGE_UNREADABLE, "empty"),
    "both images in another folder": (
        lambda d: [shutil.move(d / c / "data/0000000005.jpg", d / c) for c in ("image_02", "image_03")], 5, R.IMAGE_MISSING,
        "no left image",
    ),
    "two images of one number": (
        lambda d: shutil.copy(d / "image_02/data/0000000002.jpg", d / "image_02/data/2.jpg"), 2, R.IMAGE_UNREADABLE, "keep one",
    ),
    "latitude out of range": (change_oxts(3, 0, "91"), 3, R.POSE_INVALID, "at most 90, found 91"),
    "time stamp of 2099": (
        change_line(3, "2099-03-01 12:00:01.3"), 3, R.TIMESTAMP_INVALID, "line 4: the time is more than a day in the future",
    ),
    "right image later": (change_line(3, stamp(1.31), "image_03"), 3, R.TIMESTAMP_INVALID, "10.000 ms apart, allowed 5 ms"),
    "right stamp garbled": (change_line(3, "soon", "image_03"), 3, R.TIMESTAMP_INVALID, "image_03/timestamps.txt, line 4"),
    "degrees for radians": (change_oxts(3, 4, "12.5"), 3, R.POSE_INVALID, "pitch_rad"),
    "no sigma": (change_oxts(3, 23, "0"), 3, R.POSE_INVALID, "pos_accuracy is 0"),
    "text in OXTS": (change_oxts(3, 7, "fast"), 3, R.POSE_INVALID, "text that is not a number"),
    "short OXTS": (
        lambda d: (d / "oxts/data/0000000003.txt").write_text("49.0 8.4"), 3, R.POSE_INVALID, "expected 30 numbers, found 2",
    ),
    "broken link to an image": (replaced("image_03/data/0000000000.jpg", link_to_nothing), 0, R.IMAGE_MISSING, "a broken link"),
    "pipe for an image": (replaced("image_02/data/0000000000.jpg", os.mkfifo), 0, R.IMAGE_MISSING, "image_02/data/"),
    "broken link to OXTS": (replaced("oxts/data/0000000003.txt", link_to_nothing), 3, R.POSE_INVALID, "a broken link"),
    "folder for OXTS": (replaced("oxts/data/0000000003.txt", Path.mkdir), 3, R.POSE_INVALID, "a folder"),
    "pipe for OXTS": (replaced("oxts/data/0000000003.txt", os.mkfifo), 3, R.POSE_INVALID, "a pipe"),
    "time stamp garbled": (change_line(3, "2026-03-01"), 3, R.TIMESTAMP_INVALID, "line 4"),
    "time stamp twice": (change_line(5, stamp(1.4)), 5, R.TIMESTAMP_INVALID, "100.000 ms apart"),
    "time stamps end early": (
        lambda d: (d / "image_02/timestamps.txt").write_text("".join(f"{stamp(1 + 0.1 * i)}\n" for i in range(5))),
        5, R.TIMESTAMP_MISSING, "has no line 6 for this frame",
    ),
    "pose of another time": (
        lambda d: (d / "oxts/timestamps.txt").write_text(
            "".join(f"{stamp(1.04 + 0.1 * i + (3 if i == 5 else 0))}\n" for i in range(6))
        ),
        5, R.TIMESTAMP_INVALID, "clocks or time zones differ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LOSSES)
def test_a_broken_pair_costs_that_pair_only(drive: Path, name: str) -> None:
    damage, lost, reason, words = LOSSES[name]
    damage(drive)
    result, rejections = read_drive(drive)
    assert read_header(drive).problem is None
    kept = [i for i in range(FRAMES) if i != lost]
    if name == "time stamp twice":  # either of the two may go
        assert len(rejections) == 1
    else:
        assert numbers(result) == kept
        assert [r.record for r in rejections] == [f"frame pair {lost}"]
    assert rejections[0].reason is reason
    assert rejections[0].step == "frames"
    assert words in rejections[0].detail
    assert result.expected_frame_count == FRAMES
    json.dumps(rejections[0].payload, allow_nan=False)


def test_neighbours_of_a_bad_pose_are_interpolated_across_it(drive: Path) -> None:
    change_oxts(3, 0, "nan")(drive)
    result, (rejection,) = read_drive(drive)
    assert rejection.payload["text"].startswith("nan 11.5") and "lat_deg: " in rejection.detail
    start = geodesy.to_map(32632, LAT, LON, 120.0)
    after = next(pair for pair in result.frame_pairs if pair.frame_index == 4)
    assert np.linalg.norm((np.array(after.pose.map_t_body_m) - start)[:2]) == pytest.approx(4.0, rel=0.01)


def poses_of_a_straight_drive(numbers: range, late_ns: int) -> tuple[np.ndarray, dict[int, Pose]]:
    """Errors (N,) m of the places at exposures so much later than the records, 10 a second at 15 m/s, and the poses."""
    degrees = 15.0 * 0.1 / 111_412.84 / math.cos(math.radians(49.0))  # of longitude, about 1.5 m
    records = {n: OxtsRecord(49.0, 8.4 + n * degrees, 110.0, 0.0, 0.0, 0.0, 0.02) for n in numbers}
    times = {n: 10**18 + n * 10**8 for n in numbers}
    track = kitti.oxts_trajectory(records, times, 32632, Sigmas())
    poses = {n: kitti.oxts_pose(track, n, times[n] + late_ns) for n in numbers}
    velocity = (track.map_SE3_body[-1, :3, 3] - track.map_SE3_body[0, :3, 3]) / ((numbers[-1] - numbers[0]) * 0.1)
    true = track.map_SE3_body[:, :3, 3] + velocity * late_ns * 1e-9
    return np.linalg.norm(
        [np.subtract(poses[n].map_t_body_m, t) for n, t in zip(numbers, true, strict=True)], axis=1
    ), poses


@pytest.mark.parametrize("late_ms", [-90, -12, 0, 12, 90])
@pytest.mark.parametrize("step", [1, 4])
def test_the_first_and_last_pose_are_those_of_the_exposure(late_ms: int, step: int) -> None:
    errors, poses = poses_of_a_straight_drive(range(0, 20, step), late_ms * 10**6)
    assert errors.max() < 1e-3
    assert {pose.sigma_enu_m[0] for pose in poses.values()} == {0.02}


def test_a_pose_that_is_not_interpolated_has_a_larger_sigma() -> None:
    """Records 0.6 s apart are not interpolated: 12 ms at 15 m/s are 0.18 m."""
    errors, poses = poses_of_a_straight_drive(range(0, 60, 6), 12 * 10**6)
    assert errors == pytest.approx(0.18, rel=0.01)
    assert [pose.sigma_enu_m[0] for pose in poses.values()] == pytest.approx([math.hypot(0.02, 0.18)] * 10, rel=0.01)


def test_an_image_without_a_number_is_rejected(drive: Path) -> None:
    shutil.copy(drive / "image_02/data/0000000002.jpg", drive / "image_02/data/extra.jpg")
    result, (rejection,) = read_drive(drive)
    assert len(result.frame_pairs) == FRAMES == result.expected_frame_count
    assert rejection.record == "image_02/data/extra.jpg"


# --------------------------------------------------------------------------- no drive at all


def remove(drive: Path, *names: str) -> None:
    for name in names:
        path = drive / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()


@prepared
def settings(drive: Path, text: str) -> None:
    (drive / "drive.yaml").write_text(text)


FAILURES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no calibration": (lambda d: remove(d.parent, *CALIBRATION), "neither in the drive folder"),
    "no chain to the IMU": (lambda d: remove(d.parent, "calib_imu_to_velo.txt"), "imu_to_velo.txt missing"),
    "no OXTS": (lambda d: remove(d, "oxts"), "no poses in oxts/data"),
    "no right camera": (lambda d: remove(d, "image_03"), "image_03/data is missing"),
    "no images": (lambda d: [p.unlink() for c in ("image_02", "image_03") for p in (d / c / "data").iterdir()], "no images"),
    "no time stamps": (lambda d: remove(d, "image_02/timestamps.txt"), "image_02/timestamps.txt is missing"),
    "all poses bad": (lambda d: [change_oxts(i, 0, "nan")(d) for i in range(FRAMES)], "lat_deg: "),
    "all images bad": (lambda d: [cut(p) for p in (d / "image_02/data").iterdir()], "none of 6 frame pairs can be used"),
    "drive.yaml with an unknown key": (settings("drive: x"), "drive: unknown key"),
    "drive.yaml that is no mapping": (settings("- x"), "expected keys"),
    "unknown time zone": (settings("timestamps_timezone: Mars/Olympus"), "not a time zone"),
    "map CRS of too many digits": (settings("map_srid: 25832000"), "map_srid: expected less than 1000000"),
    "map CRS in degrees": (settings("map_srid: 4326"), "not a projected CRS"),
    "Web Mercator": (settings("map_srid: 3857"), "stretches lengths"),
    "negative sigma": (settings("sigmas: {yaw_deg: -1}"), "sigmas.yaw_deg: "),
    "one common error twice": (settings("common_errors: [{id: b, sigma_m: 1}, {id: b, sigma_m: 2}]"), "the same id"),
    "a common error without a sigma": (settings("common_errors: {id: b}"), "common_errors.0.sigma_m"),
    "calibration outside by ..": (settings("calibration: ../calib_cam_to_cam.txt"), "is outside"),
    "camera folder by ..": (settings("cameras: {left: ../x/image_02, right: image_03}"), "cameras.left"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAILURES)
def test_an_unusable_drive_raises_one_message(drive: Path, name: str) -> None:
    damage, words = FAILURES[name]
    damage(drive)
    with pytest.raises(DriveFolderError) as raised:
        read_drive(drive)
    assert words in str(raised.value)
    assert "drive_0001" in str(raised.value) or "day" in str(raised.value), "the message names the path"


def test_paths_that_are_not_drives(tmp_path: Path, drive: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"x")
    for name in ("cam0", "cam1"):
        (tmp_path / "rig" / name).mkdir(parents=True)
        (tmp_path / "rig" / name / "a.jpg").write_bytes(b"x")
    for path, words in (
        (tmp_path / "rig", f"become a drive with 'conetl init {tmp_path / 'rig'}'"),
        (tmp_path / "nowhere", "no such folder"),
        (drive / "oxts" / "timestamps.txt", "this is a file"),
        (tmp_path / "empty", "the folder is empty"),
        (tmp_path / "photos", "not a drive in KITTI's raw layout"),
        (drive.parent, f"contains one drive (drive_0001): conetl ingest {drive}"),
    ):
        with pytest.raises(DriveFolderError) as raised:
            read_drive(path)
        assert words in str(raised.value)


# --------------------------------------------------------------------------- drive.yaml and content


def test_drive_yaml_overrides(drive: Path) -> None:
    for name in CALIBRATION:
        (drive / "calibration").mkdir(exist_ok=True)
        shutil.move(drive.parent / name, drive / "calibration" / name)
    (drive / "drive.yaml").write_text(
        """
drive_id: morning run
rig_id: van-3
map_srid: 25832
timestamps_timezone: Europe/Berlin
calibration: calibration/calib_cam_to_cam.txt
sigmas: {horizontal_m: 0.05, vertical_m: 0.1, roll_deg: 0.1, pitch_deg: 0.2, yaw_deg: 0.3, image_px: 0.7}
"""
    )
    result, rejections = read_drive(drive)
    assert rejections == []
    found = (result.drive_id, result.rig.rig_id, result.map_srid, result.rig.sigma_px)
    assert found == ("morning run", "van-3", 25832, 0.7)
    assert result.frame_pairs[0].captured_at_ns == 1_772_362_801_000_000_000, "12:00 in Berlin in March is 11:00 UTC"
    assert result.frame_pairs[0].pose.sigma_enu_m == (0.05, 0.05, 0.1)
    np.testing.assert_allclose(result.frame_pairs[0].pose.sigma_rpy_rad, np.radians([0.1, 0.2, 0.3]))
    assert read_drive(drive, map_srid=32632)[0].map_srid == 32632, "the map's own CRS wins"


def test_pos_accuracy_does_not_matter_where_the_sigma_is_given(drive: Path) -> None:
    change_oxts(3, 23, "0")(drive)
    (drive / "drive.yaml").write_text("sigmas: {horizontal_m: 0.05}")
    assert read_drive(drive)[1] == []


def test_common_errors_are_a_part_of_the_stated_sigmas_which_grow_where_they_are_smaller(drive: Path) -> None:
    first = read_drive(drive)[0]
    (drive / "drive.yaml").write_text("sigmas: {horizontal_m: 0.05}\ncommon_errors: {id: base-north, sigma_m: 0.02}")
    result, rejections = read_drive(drive)
    assert rejections == [] and result.content_sha256 != first.content_sha256
    assert [(one.id, one.sigma_m, one.axes) for one in result.common_errors] == [("base-north", (0.02,) * 3, "map")]
    np.testing.assert_allclose(result.frame_pairs[0].pose.sigma_enu_m, (0.05, 0.05, 0.075))
    text = "[{id: base, sigma_m: [0.03, 0.03, 0.1]}, {id: antenna, sigma_m: [0.04, 0, 0], axes: vehicle}]"
    (drive / "drive.yaml").write_text(f"sigmas: {{horizontal_m: 0.01}}\ncommon_errors: {text}")
    pose = read_drive(drive)[0].frame_pairs[0].pose
    forward = np.array(pose.map_R_body)[:, 0]
    np.testing.assert_allclose(np.square(pose.sigma_enu_m), np.square([0.03, 0.03, 0.1]) + np.square(0.04 * forward))


def test_the_content_hash_depends_on_bytes_and_not_on_the_path(drive: Path, tmp_path: Path) -> None:
    first = read_drive(drive)[0].content_sha256
    assert read_drive(drive)[0].content_sha256 == first
    copy = tmp_path / "elsewhere" / "drive_0001"
    shutil.copytree(drive.parent, copy.parent)
    assert read_drive(copy)[0].content_sha256 == first
    seen = {first}
    other_calibration = CALIBRATION["calib_imu_to_velo.txt"].replace("-0.81", "-0.812")
    for change in (
        change_oxts(2, 3, "0.011"),
        change_line(5, stamp(1.51)),
        lambda d: shutil.copy(d / "image_02/data/0000000001.jpg", d / "image_02/data/0000000002.jpg"),
        lambda d: cut(d / "image_03/data/0000000004.jpg"),
        settings("drive_id: drive_0001"),
        lambda d: (d.parent / "calib_imu_to_velo.txt").write_text(other_calibration),
    ):
        change(copy)
        seen.add(read_drive(copy)[0].content_sha256)
    assert len(seen) == 7


def test_a_clock_that_was_not_set_is_found_although_its_times_rise() -> None:
    day, start = 86_400 * 10**9, parse_timestamp("2026-03-02 09:41:00")
    rising = {n: start + n * 10**8 for n in range(1, 9)}
    assert misplaced(rising) == {}
    assert list(misplaced({0: 5 * 10**9} | rising)) == [0]
    assert "not set" in misplaced({0: 5 * 10**9} | rising)[0]
    assert "is 30.0 days" in misplaced({0: start - 30 * day} | rising)[0]
    assert list(misplaced(rising | {9: start + 2 * day})) == [9]
    assert misplaced(rising | {9: start + day // 2}) == {}, "a drive may rest"
    two_days = misplaced(rising | {n: start + 27 * day // 24 + n for n in range(9, 14)})
    assert list(two_days) == [9, 10, 11, 12, 13]
    assert "is 1.1 days from" in two_days[9] and "frame pairs 9 to 13 are of another recording: split" in two_days[9]
    next_morning = misplaced(rising | {n: start + 17 * day // 24 + n for n in range(9, 12)})
    assert "is 0.7 days from" in next_morning[9] and "frame pairs 9 to 11 are of another recording" in next_morning[9]
    assert list(misplaced({n: n for n in range(3)})) == [0, 1, 2]
    assert misplaced({}) == {}
    assert "is not in the order of recording" in misplaced(rising | {9: start})[9]
