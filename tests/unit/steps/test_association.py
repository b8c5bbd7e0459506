"""Fragments of tracks: what is joined, and in which order."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.params import IngestParams
from conetl.records import Position
from conetl.steps.association import join_fragments, misfit_of

PARAMS = IngestParams().track
Groups = list[tuple[Position, ...]]
POSES = {n: np.array([[0, 0, 1, 0.8 * n], [-1, 0, 0, 0], [0, -1, 0, 1.6], [0, 0, 0, 1.0]]) for n in range(40)}


def position(frame: int, number: int, along_m: float, aside_m: float) -> Position:
    """A sighting of something that stands so far along the road and beside it."""
    xyz = (-aside_m, 1.6, along_m - 0.8 * frame)
    return Position(
        frame_index=frame, match_index=number, xyz_m=(along_m, aside_m, 0.0), cov_m2=(0.01, 0, 0, 0.01, 0, 0.01),
        centre_xyz_m=(along_m, aside_m, 0.3), cone_height_m=0.6, camera_xyz_m=xyz, camera_cov_m2=(0.01, 0, 0, 0.01, 0, 0.04),
        range_m=30.0, ray_angle_rad=0.02, residual_rms_px=0.2, iterations=2, score=0.8,
    )  # fmt: skip


def one_after_the_other(groups: Groups) -> Groups:
    """All groups compared anew after each joint."""
    joined = sorted(groups, key=lambda g: g[0].frame_index)
    while True:
        found = [
            (misfit, i, j)
            for i in range(len(joined))
            for j in range(i + 1, len(joined))
            if (misfit := misfit_of(joined[i], joined[j], POSES, PARAMS, None)) is not None
        ]
        if not found:
            return joined
        _, i, j = min(found)
        merged = tuple(sorted((*joined[i], *joined[j]), key=lambda p: p.frame_index))
        joined = [group for k, group in enumerate(joined) if k not in (i, j)] + [merged]


@st.composite
def fragments(draw: st.DrawFn) -> Groups:
    """Pieces of tracks of a few things that stand near each other, some of them in the same frames."""
    groups = []
    for number in range(draw(st.integers(1, 9))):
        frames = sorted(draw(st.sets(st.integers(0, 39), min_size=1, max_size=6)))
        along, aside = draw(st.sampled_from([(40.0, 3.0), (40.8, 3.0), (43.0, -2.0)]))
        offsets = draw(st.lists(st.floats(-0.3, 0.3), min_size=2, max_size=2))
        groups.append(tuple(position(n, number, along + offsets[0], aside + offsets[1]) for n in frames))
    return groups


@settings(max_examples=60, deadline=None)
@given(fragments())
def test_the_best_fit_is_joined_first_whatever_is_remembered(groups: Groups) -> None:
    assert join_fragments(groups, POSES, PARAMS) == one_after_the_other(groups)


def test_groups_with_a_common_frame_are_two_cones() -> None:
    one = (position(3, 0, 40.0, 3.0), position(4, 0, 40.0, 3.0))
    assert misfit_of(one, (position(4, 1, 40.0, 3.0),), POSES, PARAMS, None) is None
    assert misfit_of(one, (position(6, 1, 40.0, 3.0),), POSES, PARAMS, None) is not None
    assert len(join_fragments([one, (position(6, 1, 40.0, 3.0),)], POSES, PARAMS)) == 1
