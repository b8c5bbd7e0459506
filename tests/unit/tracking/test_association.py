"""Chains and their fragments: the same groups as by comparing all pairs of groups."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.geometry import pose as se3
from conetl.geometry.packing import cov3, cov_matrix
from conetl.model.drive import Position
from conetl.model.params import TrackParams
from conetl.tracking.association import CameraMotion, MotionError, _reach_m, _within_reach, join_fragments, misfit_of

PARAMS = TrackParams()
STEP_M = 0.8


def path(frames: int) -> dict[int, np.ndarray]:
    """Camera axes along the map's; the car drives along z."""
    poses = {}
    for k in range(frames):
        poses[k] = np.eye(4)
        poses[k][2, 3] = STEP_M * k
    return poses


def position(frame: int, xyz_m: np.ndarray, sigma_m: float, poses: dict[int, np.ndarray]) -> Position:
    seen = xyz_m - poses[frame][:3, 3]
    cov = tuple(map(float, cov3(np.diag([sigma_m**2, sigma_m**2, (3 * sigma_m) ** 2]))))
    return Position.model_construct(
        frame_index=frame, match_index=0, xyz_m=tuple(xyz_m), cov_m2=cov, camera_xyz_m=tuple(seen), camera_cov_m2=cov
    )


def drifting(m2_a_frame: float) -> MotionError:
    """A motion with an error proportional to the number of frames."""
    most = m2_a_frame * 400
    return MotionError(lambda a, b, _: m2_a_frame * abs(a - b) * np.eye(3), most_m2=lambda _: 3 * most)


def joined_one_by_one(groups, poses, motion):
    """The definition: compare all pairs, join the best, repeat."""
    groups = sorted(groups, key=lambda g: g[0].frame_index)
    while True:
        fits = [
            (misfit, i, j)
            for i in range(len(groups))
            for j in range(i + 1, len(groups))
            if (misfit := misfit_of(groups[i], groups[j], CameraMotion(poses, PARAMS, motion))) is not None
        ]
        if not fits:
            return groups
        _, i, j = min(fits)
        merged = tuple(sorted((*groups[i], *groups[j]), key=lambda p: p.frame_index))
        groups = [g for k, g in enumerate(groups) if k not in (i, j)] + [merged]


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), cones=st.integers(1, 8), m2_a_frame=st.sampled_from([0.0, 1e-5, 1e-3, None]))
def test_fragments_are_joined_as_by_comparing_all_with_all(seed, cones, m2_a_frame):
    rng = np.random.default_rng(seed)
    poses = path(400)
    motion = None if m2_a_frame is None else drifting(m2_a_frame)
    groups = []
    for _ in range(cones):
        place = np.array([rng.uniform(-4, 4), 1.0, rng.uniform(0, 60)])
        frames = np.unique(rng.integers(0, 400, rng.integers(1, 12)))
        pieces = np.split(frames, np.unique(rng.integers(0, len(frames) + 1, 3)))
        groups += [
            tuple(position(int(f), place + rng.normal(0, 0.05, 3), 0.05, poses) for f in piece)
            for piece in pieces
            if len(piece)
        ]
    found = join_fragments(groups, CameraMotion(poses, PARAMS, motion))
    assert found == joined_one_by_one(groups, poses, motion)


@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.5, 1.5))
def test_the_reach_is_that_of_the_covariance(seed, share):
    """Without matrices the same bound as with `CameraMotion.carry`, for any rotation."""
    rng = np.random.default_rng(seed)
    poses = {k: se3.se3(se3.rotation_from_rpy(*rng.uniform(-3, 3, 3)), 5e6 + rng.uniform(-40, 40, 3)) for k in range(2)}
    cov = tuple(map(float, cov3(np.diag(rng.uniform(0.01, 0.5, 3)) + 0.005)))
    one, other = (
        Position.model_construct(frame_index=k, camera_xyz_m=tuple(rng.uniform(-9, 9, 3)), camera_cov_m2=cov)
        for k in range(2)
    )
    camera = CameraMotion(poses, PARAMS)
    mean, carried = camera.carry(np.array(one.camera_xyz_m), cov_matrix(cov), 0, 1)
    reach_m = _reach_m(float(np.trace(carried)), PARAMS)
    away = rng.normal(size=3)
    place = mean + share * reach_m * away / np.linalg.norm(away)
    one, other = (
        p.model_copy(update={"xyz_m": tuple(se3.apply(poses[p.frame_index], np.array(seen)))})
        for p, seen in ((one, one.camera_xyz_m), (other, place))
    )
    if abs(share - 1) * reach_m > 1e-5:
        assert _within_reach(one, other, camera) == (share < 1)


def test_of_alternating_frames_the_most_precise_pair_is_compared():
    """Far away one object may be followed as two, whose frames alternate. The first of all neighbouring pairs has a vague
    position, 2.5 m away along the line of sight, beyond the reach of the precise one before it."""
    poses = path(6)
    camera = CameraMotion(poses, PARAMS, drifting(1e-5))

    def at(frame: int, depth_m: float, sigma_m: float = 0.05) -> Position:
        return position(frame, np.array([0.5, 1.0, depth_m]), sigma_m, poses)

    before, vague = tuple(at(k, 20.0) for k in (0, 2, 4)), at(1, 22.5, 0.9)
    assert misfit_of(before[:1], (vague,), camera) is None
    after, beyond = (tuple(at(k, depth) for k in (3, 5)) for depth in (20.1, 21.6))
    assert [len(group) for group in join_fragments([before, (vague, *after)], camera)] == [6]
    assert len(join_fragments([before, (vague, *beyond)], camera)) == 2


def test_groups_beyond_any_error_are_not_compared():
    poses, compared = path(400), []

    def cov_m2(start, end, _point_m):
        compared.append((start, end))
        return np.zeros((3, 3))

    groups = [(position(k, np.array([0.0, 1.0, 30.0 + STEP_M * k]), 0.01, poses),) for k in range(0, 400, 5)]
    motion = MotionError(cov_m2, most_m2=lambda _: 1e-4)
    assert len(join_fragments(groups, CameraMotion(poses, PARAMS, motion))) == len(groups)
    assert len(compared) < 2 * len(groups)
    assert (
        join_fragments([], CameraMotion(poses, PARAMS, motion)) == join_fragments([], CameraMotion(poses, PARAMS)) == []
    )
