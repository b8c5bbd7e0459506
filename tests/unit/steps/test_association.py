"""Chains and fragments of them: the same groups as by comparing every group with every other, on drives of any length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.geometry.packing import cov3
from conetl.params import TrackParams
from conetl.records import Position
from conetl.steps.association import MotionError, join_fragments, misfit_of

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
    """A motion whose error grows with the frames in between."""
    most = m2_a_frame * 400
    return MotionError(lambda a, b, _: m2_a_frame * abs(a - b) * np.eye(3), most_m2=lambda _: 3 * most)


def joined_one_by_one(groups, poses, motion):
    """The rule as it is written: compare all with all, join the best, begin again."""
    groups = sorted(groups, key=lambda g: g[0].frame_index)
    while True:
        fits = [
            (misfit, i, j)
            for i in range(len(groups))
            for j in range(i + 1, len(groups))
            if (misfit := misfit_of(groups[i], groups[j], poses, PARAMS, motion)) is not None
        ]
        if not fits:
            return groups
        _, i, j = min(fits)
        merged = tuple(sorted((*groups[i], *groups[j]), key=lambda p: p.frame_index))
        groups = [g for k, g in enumerate(groups) if k not in (i, j)] + [merged]


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
    found = join_fragments(groups, poses, PARAMS, motion)
    assert found == joined_one_by_one(groups, poses, motion)


def test_groups_that_no_error_brings_together_are_not_compared():
    poses, asked = path(400), []

    def cov_m2(start, end, _point_m):
        asked.append((start, end))
        return np.zeros((3, 3))

    groups = [(position(k, np.array([0.0, 1.0, 30.0 + STEP_M * k]), 0.01, poses),) for k in range(0, 400, 5)]
    motion = MotionError(cov_m2, most_m2=lambda _: 1e-4)
    assert len(join_fragments(groups, poses, PARAMS, motion)) == len(groups)
    assert len(asked) < 2 * len(groups)


@pytest.mark.parametrize("motion", [None, drifting(1e-5)])
def test_nothing_to_join(motion):
    assert join_fragments([], path(2), PARAMS, motion) == []
