"""The roll of drives whose log has positions only, from drawn posts; images without upright edges tell nothing."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.model.arrays import Image
from conetl.model.drive import FramePair
from conetl.model.rejections import RejectionReason
from conetl.model.rig import Side
from conetl.perception.images import ImageFileError
from conetl.tracking.trajectory import refine_trajectory
from conetl.tracking.upright_edges import edges_near, tilt_of, with_roll
from tests.synthetic.good_drives import PARAMS, RIG
from tests.synthetic.odometry import motions_of, pose_errors
from tests.synthetic.sparse_drive import record

CAMERA = RIG.left


def drawn(
    map_SE3_left: np.ndarray, feet: np.ndarray, tops: np.ndarray, oblique: int, rng: np.random.Generator
) -> Image:
    """An image of posts from feet to tops (N, 3), and of lines of any direction."""
    image = np.full((CAMERA.height_px, CAMERA.width_px), 170, dtype=np.uint8)
    ends = np.stack([feet, tops], axis=1)
    at = (ends - map_SE3_left[:3, 3]) @ map_SE3_left[:3, :3]
    at = at[(at[..., 2] > 3.0).all(axis=1) & (at[..., 2] < 60.0).all(axis=1)]
    px = at[..., :2] / at[..., 2:] * CAMERA.fx_px + (CAMERA.cx_px, CAMERA.cy_px)
    middle = rng.uniform((0, 0), (CAMERA.width_px, CAMERA.height_px), (oblique, 1, 2))
    way = rng.uniform(0, np.pi, oblique)
    half = 30 * np.stack([np.cos(way), np.sin(way)], axis=1)[:, None] * np.array([[-1], [1]])
    for first, second in np.concatenate([px, middle + half]):
        ends_px = [tuple(int(v) for v in np.round(16 * end)) for end in (first, second)]
        cv2.line(image, *ends_px, int(rng.integers(20, 120)), int(rng.integers(2, 7)), cv2.LINE_AA, 4)
    return np.asarray(np.clip(image + rng.normal(0, 2, image.shape), 0, 255), dtype=np.uint8)


def posts(places: np.ndarray, rng: np.random.Generator, lean_deg: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Feet and tops (N, 3) along a path (K, 3), each leaning by its own."""
    at = places[rng.integers(0, len(places), 6 * len(places))]
    feet = at + rng.uniform((-25, -25, -1), (25, 25, 1), at.shape)
    lean = np.radians(lean_deg) * rng.normal(0, 1, (len(feet), 2))
    return feet, feet + rng.uniform(1, 6, (len(feet), 1)) * np.column_stack([lean, np.ones(len(feet))])


def reader(truth: np.ndarray, seed: int, *, upright: bool = True) -> Callable[[FramePair, Side], Image]:
    rng = np.random.default_rng(seed)
    feet, tops = posts(truth[:, :3, 3], rng)
    own = np.array(RIG.body_SE3_left)
    if not upright:
        feet, tops = feet[:0], tops[:0]
    return lambda pair, _: drawn(truth[pair.frame_index] @ own, feet, tops, 30 if upright else 150, rng)


def rolled(seed: int, roll_deg: float, **how: float) -> tuple[np.ndarray, list[RelativeMotion], list[FramePair]]:
    """True poses of a drive on a road with crossfall, its odometry, and frame pairs with the poses of a course."""
    drive = record(seed, seconds=12.0, **how)
    truth = drive.truth @ se3.se3(Rotation.from_euler("x", roll_deg, degrees=True).as_matrix(), np.zeros(3))
    return truth, motions_of(truth, RIG, np.random.default_rng(seed), PARAMS), drive.frame_pairs(0.0)


@pytest.mark.parametrize(
    ("seed", "roll_deg", "sigma_m"), [(1, -2.0, 0.02), (2, -4.0, 0.4), (4, 5.0, 0.02), (5, 0.0, 0.02)]
)
def test_edges_show_the_roll_of_a_drive_within_its_sigma(seed: int, roll_deg: float, sigma_m: float) -> None:
    truth, motions, pairs = rolled(seed, roll_deg, sigma_m=sigma_m)
    found = with_roll(pairs, RIG, motions, reader(truth, seed), PARAMS)
    result = refine_trajectory(found, RIG, motions, PARAMS)
    off_rad, sigma_rad = (
        pose_errors(result.frame_pairs, truth)[:, 3],
        [p.pose.sigma_rpy_rad[0] for p in result.frame_pairs],
    )
    assert max(sigma_rad) < np.radians(0.4)
    assert np.abs(off_rad / sigma_rad).max() < 2.0


@settings(max_examples=5, deadline=None)
@given(roll_deg=st.floats(-6, 6), pitch_deg=st.floats(-1, 1), bend_deg=st.floats(-90, 90), seed=st.integers(0, 99))
def test_a_tilt_is_found_in_bends_too(roll_deg: float, pitch_deg: float, bend_deg: float, seed: int) -> None:
    """Attitudes whose error is constant in the map, as that of odometry is; in a bend a roll becomes a pitch."""
    rng, own = np.random.default_rng(seed), np.array(RIG.body_SE3_left)
    yaw, along = np.radians(np.linspace(-bend_deg / 2, bend_deg / 2, 13)), np.arange(13.0)
    true = se3.se3(se3.rotation_from_rpy(0 * yaw, 0 * yaw, yaw), np.stack([along, 0 * along, 0 * along], axis=1)) @ own
    feet, tops = posts(true[:, :3, 3], rng)
    turn = true[6, :3, :3] @ np.radians([pitch_deg, 0.0, roll_deg])
    given = Rotation.from_rotvec(-turn).as_matrix() @ true[:, :3, :3]
    edges = [
        edges_near(drawn(one, feet, tops, 30, rng), CAMERA, way, given[6]) for one, way in zip(true, given, strict=True)
    ]
    tilt, cov = tilt_of(np.concatenate(edges))
    off_rad, sigma_rad = tilt[0] - np.radians(roll_deg), np.sqrt(cov[0, 0])
    assert sigma_rad < np.radians(0.3)
    assert abs(off_rad) < 3 * np.hypot(sigma_rad, np.radians(0.25)), np.degrees([off_rad, sigma_rad])


def test_images_without_upright_edges_change_nothing() -> None:
    truth, motions, pairs = rolled(1, 3.0)

    def broken(pair: FramePair, side: Side) -> Image:
        raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, f"{pair.left_path} is broken")

    assert with_roll(pairs, RIG, motions, reader(truth, 1, upright=False), PARAMS) == tuple(pairs)
    assert with_roll(pairs, RIG, motions, broken, PARAMS) == tuple(pairs)
    assert with_roll(pairs, RIG, [], reader(truth, 1), PARAMS) == tuple(pairs)


def test_a_camera_that_looks_to_the_side_shows_no_roll() -> None:
    """About its optical axis the vehicle pitches."""
    truth, motions, pairs = rolled(1, 3.0)
    aside = se3.se3(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.zeros(3))
    own = {
        f"body_SE3_{side}": se3.to_matrix4(aside @ np.array(getattr(RIG, f"body_SE3_{side}")))
        for side in ("left", "right")
    }
    rig = RIG.model_copy(update=own)
    motions = motions_of(truth, rig, np.random.default_rng(1), PARAMS)
    assert with_roll(pairs, rig, motions, reader(truth @ aside, 1), PARAMS) == tuple(pairs)


def test_a_recording_that_pauses_has_fewer_images_than_parts() -> None:
    truth, motions, pairs = rolled(1, 3.0)
    later = [
        pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + 900 * 10**9 * (k > 4)})
        for k, pair in enumerate(pairs)
    ]
    assert len(with_roll(later[:10], RIG, motions[:9], reader(truth, 1), PARAMS)) == 10
