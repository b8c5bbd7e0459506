"""Poses at the exposures from sparse records, with and without attitude."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.geodesy import to_geodetic
from conetl.model.errors import InputError
from conetl.readers.drives import read_drive
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.pairs import ContentHash, PairError, Source
from conetl.readers.drives.poses import Samples, at, placed
from conetl.readers.drives.sparse_poses import pose_reader, with_course
from conetl.readers.trajectories.recorded import RecordedTrajectory
from tests.folders import KITTI, needs_kitti

START_NS = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def track(step_s: float, seconds: float = 20.0, *, bad: dict[int, str] | None = None) -> Samples:
    """A car that goes east at 10 m/s, with recorded attitudes."""
    times_s = np.arange(0.0, seconds, step_s)
    poses = se3.se3(
        se3.rotation_from_rpy(0 * times_s, 0 * times_s, 0.01 * times_s),
        np.stack([10.0 * times_s, 0 * times_s, 0 * times_s], axis=1),
    )
    sigma = np.tile([0.4, 0.4, 0.6, 0.001, 0.001, 0.003], (len(times_s), 1))
    return Samples("gnss.csv", [START_NS + round(t * 1e9) for t in times_s], poses, sigma, bad or {})


@settings(max_examples=30, deadline=None)
@given(step_s=st.sampled_from([0.01, 0.1, 0.25]), instant_s=st.floats(0.0, 19.5))
def test_a_dense_trajectory_is_interpolated_as_ever(step_s: float, instant_s: float) -> None:
    dense, time_ns = track(step_s), START_NS + round(instant_s * 1e9)
    assert pose_reader(dense, [time_ns])(time_ns) == se3.to_pose(*at(dense, time_ns, SECOND // 2))


@pytest.mark.parametrize("from_course", [True, False])
def test_records_of_1_hz_are_interpolated_and_marked(from_course: bool) -> None:
    exposures = [START_NS + k * SECOND // 10 for k in range(50, 120)]
    pose_at = pose_reader(track(1.0), exposures, from_course=from_course)
    for time_ns in exposures:
        pose = pose_at(time_ns)
        assert pose.map_t_body_m[0] == pytest.approx((time_ns - START_NS) * 1e-8, abs=0.05)
        assert pose.interpolated is not None
        assert pose.interpolated.apart_s == pytest.approx(1.0)
        assert all(part < whole for part, whole in zip(pose.interpolated.sigma_enu_m, pose.sigma_enu_m, strict=True))
        assert pose.sigma_enu_m[0] >= 0.99 * 0.4
        assert (pose.sigma_rpy_rad[0] > 0.04) == from_course


def test_a_turn_between_two_attitudes_is_as_wrong_as_stated() -> None:
    """A vehicle that turns ever faster, by 0.5 rad/s^2, between records of 1 Hz."""
    yaws = 0.25 * np.arange(0.0, 6.0) ** 2
    turning = track(1.0, 6.0)
    turning.map_SE3_body[:, :3, :3] = se3.rotation_from_rpy(0 * yaws, 0 * yaws, yaws)
    for at_s in (2.25, 2.5, 3.9):
        time_ns = START_NS + round(at_s * 1e9)
        pose = pose_reader(turning, [time_ns])(time_ns)
        off = 0.25 * at_s**2 - np.arctan2(pose.map_R_body[1][0], pose.map_R_body[0][0])
        assert pose.interpolated is not None
        assert pose.interpolated.sigma_rpy_rad[2] == pytest.approx(abs((off + np.pi) % (2 * np.pi) - np.pi), rel=1e-6)


def test_a_lost_or_bad_record_costs_itself_and_a_long_gap_the_pairs_in_it() -> None:
    whole = track(1.0)
    kept = [k for k in range(20) if k != 5 and k not in (12, 13, 14)]
    bad = {whole.times_ns[5]: "line 7: no fix", whole.times_ns[13]: "line 15: no fix"}
    holed = Samples("gnss.csv", [whole.times_ns[k] for k in kept], whole.map_SE3_body[kept], whole.sigma[kept], bad)
    times = [START_NS + round(t * 1e9) for t in (5.2, 9.5, 13.2, 30.0)]
    pose_at = pose_reader(holed, times, from_course=True)
    assert pose_at(times[0]).sigma_enu_m[0] > pose_at(times[1]).sigma_enu_m[0]
    with pytest.raises(PairError, match="line 15"):
        pose_at(times[2])
    with pytest.raises(PairError, match=r"ended 11\.000 s before"):
        pose_at(times[3])
    assert pose_reader(holed, times, 4.0, from_course=True)(times[2]).map_t_body_m[0] == pytest.approx(132, abs=0.1)


def test_a_vehicle_that_never_moves_is_refused_with_the_reason() -> None:
    still = track(1.0)
    still.map_SE3_body[:, :3, 3] = 0.0
    with pytest.raises(InputError, match=r"gnss\.csv: it has no attitudes, and .* never show the vehicle moving"):
        pose_reader(still, [START_NS + SECOND], from_course=True)
    with pytest.raises(InputError, match="at least three"):
        pose_reader(track(1.0, seconds=2.0), [START_NS], from_course=True)


def test_the_course_is_relative_to_true_north() -> None:
    """Far east of the central meridian grid north and true north differ by 2 degrees."""
    times_s = np.arange(0.0, 20.0)
    lat, lon = 49.0 + 0 * times_s, 11.9 + 1e-4 * times_s  # due east
    recorded = RecordedTrajectory(
        "gnss.csv", (START_NS + times_s * 1e9).astype(np.int64), np.stack([lat, lon, 100 + 0 * lat], axis=1), False, None,
        np.full((20, 6), np.nan), {},
    )  # fmt: skip
    found = with_course(recorded)
    assert found.rotations is not None
    yaw = np.arctan2(found.rotations[:, 1, 0], found.rotations[:, 0, 0])
    assert np.abs(np.degrees(yaw)).max() < 0.1
    assert np.isfinite(found.sigma[:, 3:]).all()
    assert with_course(found) is found


@needs_kitti
def test_a_real_street_at_1_hz_without_attitude() -> None:
    """What a 1 Hz receiver would have recorded, against the OXTS records between."""
    drive, _ = read_drive(KITTI, headers_only=True)
    sparse = drive.frame_pairs[::10]
    positions = np.array([pair.pose.map_t_body_m for pair in sparse])
    assert to_geodetic(drive.map_srid, positions).shape == (16, 3)
    samples = Samples(
        "oxts", [pair.captured_at_ns for pair in sparse], se3.se3(np.eye(3), positions),
        np.array([(*pair.pose.sigma_enu_m, *pair.pose.sigma_rpy_rad) for pair in sparse]), {},
    )  # fmt: skip
    inside = [pair for pair in drive.frame_pairs if pair.captured_at_ns <= sparse[-1].captured_at_ns]
    pose_at = pose_reader(samples, [pair.captured_at_ns for pair in inside], from_course=True)
    for pair in inside:
        pose = pose_at(pair.captured_at_ns)
        assert pose.interpolated is not None
        off = np.abs(np.array(pose.map_t_body_m) - pair.pose.map_t_body_m)
        assert (off < 3 * np.array(pose.interpolated.sigma_enu_m)).all()
        assert off.max() < 0.15
        turned = np.array(pair.pose.map_R_body).T @ np.array(pose.map_R_body)
        assert abs(np.arctan2(turned[1, 0], turned[0, 0])) < 3 * pose.sigma_rpy_rad[2]


@pytest.mark.parametrize(("forward", "ends"), [("x", True), ("-x", True), ("y", True), ("z", False), ("-z", False)])
def test_local_poses_of_a_camera_are_not_those_of_a_vehicle(forward: str, ends: bool, tmp_path: Path) -> None:
    """ORB-SLAM writes TUM's lines with the axes of the camera: z forward."""
    steps = 1.2 * np.arange(12.0)[:, None] * np.eye(3)["xyz".index(forward[-1])] * (-1 if forward[0] == "-" else 1)
    turn = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    times = 1_772_444_467 * 10**9 + np.arange(12) * 10**8
    recorded = RecordedTrajectory(
        "CameraTrajectory.txt", times, steps @ turn.T, True, np.tile(turn, (12, 1, 1)), np.full((12, 6), np.nan), {}
    )
    place = {"lon_deg": 8.43, "lat_deg": 49.0, "height_m": 116.0, "heading_deg": 57.0}
    stated = DriveYaml.model_validate({"georeference": place, "sigmas": {"horizontal_m": 0.02}})
    source = Source(tmp_path, tmp_path, stated, ContentHash())
    if ends:
        assert len(placed(recorded, source, np.eye(3))[1].times_ns) == 12
    else:
        with pytest.raises(InputError, match="move along their z axis, as those of a camera do"):
            placed(recorded, source, np.eye(3))
