"""The chain solver against the dense solution of the same normal equations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conetl.geometry.motion.chain_solver import (
    ChainNormal,
    ChainPoints,
    covariance,
    cross_covariance,
    eliminate,
    joint_covariance,
    solve,
    solve_with_points,
    with_points,
)


def random_normal(seed: int, count: int, size: int, shared: int) -> tuple[ChainNormal, np.ndarray, np.ndarray]:
    """Normal equations of random measurements, and the same as one dense matrix and right side."""
    rng = np.random.default_rng(seed)
    total = count * size + shared
    rows = []
    for k in range(count):
        design = np.zeros((2 * size + shared, total))
        end = min(k + 2, count)
        design[:, k * size : end * size] = rng.normal(size=(2 * size + shared, size * (end - k)))
        design[:, count * size :] = rng.normal(size=(2 * size + shared, shared))
        rows.append(design)
    design = np.vstack(rows)
    dense, right = design.T @ design, design.T @ rng.normal(size=len(design))
    blocks = dense[: count * size, : count * size].reshape(count, size, count, size)
    index = np.arange(count)
    normal = ChainNormal(
        blocks[index, :, index].copy(),
        blocks[index[:-1], :, index[1:]].copy(),
        dense[: count * size, count * size :].reshape(count, size, shared).copy(),
        dense[count * size :, count * size :].copy(),
        right[: count * size].reshape(count, size).copy(),
        right[count * size :].copy(),
    )
    return normal, dense, right


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 7), st.integers(1, 4), st.integers(0, 3))
def test_equals_the_dense_solution(seed: int, count: int, size: int, shared: int) -> None:
    normal, dense, right = random_normal(seed, count, size, shared)
    chain_of = eliminate(normal)
    states, common = solve(chain_of)
    expected = np.linalg.solve(dense, right)
    assert np.allclose(np.concatenate([states.ravel(), common]), expected, rtol=1e-6, atol=1e-8)
    inverse = np.linalg.inv(dense)
    result = covariance(chain_of)
    chain = inverse[: count * size, : count * size].reshape(count, size, count, size)
    for first in range(count):
        assert np.allclose(result.of(first), chain[first, :, first], rtol=1e-6, atol=1e-9)
        assert np.allclose(result.variances[first], np.diag(chain[first, :, first]), rtol=1e-6, atol=1e-9)
        for second in range(first, count):
            assert np.allclose(cross_covariance(result, first, second), chain[first, :, second], rtol=1e-6, atol=1e-9)
    assert np.allclose(result.shared, inverse[count * size :, count * size :], rtol=1e-6, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), count=st.integers(1, 9), shared=st.integers(0, 2), points=st.integers(0, 5))
def test_points_that_leave_on_the_way_change_nothing(seed: int, count: int, shared: int, points: int) -> None:
    """As with the points among the shared unknowns, in any order of sightings, some seen once, some from end to end."""
    rng = np.random.default_rng(seed)
    normal = random_normal(seed, count, 4, shared)[0]
    ties = [(state, point) for point in range(points) for state in rng.choice(count, rng.integers(1, count + 1), False)]
    rng.shuffle(ties)
    state, point = np.array(ties, dtype=int).reshape(-1, 2).T
    by_state, by_point = rng.normal(size=(len(ties), 5, 3)), rng.normal(size=(len(ties), 5, 3))
    corner, right = np.stack([np.eye(3)] * points) if points else np.zeros((0, 3, 3)), rng.normal(size=(points, 3))
    np.add.at(normal.diagonal[:, :3, :3], state, np.swapaxes(by_state, 1, 2) @ by_state)
    np.add.at(corner, point, np.swapaxes(by_point, 1, 2) @ by_point)
    tied = ChainPoints(state, point, np.swapaxes(by_state, 1, 2) @ by_point, corner, right)
    found = solve_with_points(normal, tied)
    states, others = solve(eliminate(with_points(normal, tied)))
    assert np.allclose(found[0], states, rtol=1e-6, atol=1e-8)
    assert np.allclose(np.concatenate([found[1], found[2].ravel()]), others, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("count", [16, 17, 33, 600])
def test_far_states_are_reached_in_strides(count: int) -> None:
    result = covariance(eliminate(random_normal(count, count, 2, 1)[0]))
    ends = (0, count - 1), (0, count // 2), (3, count - 2), (count // 3, count - 1), (count - 1, count - 1)
    for first, second in ends:
        step_by_step = result.chain[second]
        for k in range(second - 1, first - 1, -1):
            step_by_step = result.gain[k] @ step_by_step
        step_by_step = step_by_step + result.reach[first] @ result.shared @ result.reach[second].T
        assert np.allclose(cross_covariance(result, first, second), step_by_step, rtol=1e-9, atol=1e-15)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.sets(st.integers(0, 8), max_size=9), st.integers(1, 3), st.integers(0, 2))
def test_any_states_together(seed: int, chosen: set[int], unknowns: int, shared: int) -> None:
    """The same as of each two of them."""
    result, states = covariance(eliminate(random_normal(seed, 9, 3, shared)[0])), sorted(chosen)
    joint = joint_covariance(result, states, unknowns)
    assert joint.shape == (unknowns * len(states), unknowns * len(states))
    blocks = joint.reshape(len(states), unknowns, len(states), unknowns)
    for a, first in enumerate(states):
        for b, second in enumerate(states[a:], a):
            expected = cross_covariance(result, first, second)[:unknowns, :unknowns]
            assert np.allclose(blocks[a, :, b], expected, rtol=1e-8, atol=1e-12)
            assert np.allclose(blocks[b, :, a], expected.T, rtol=1e-8, atol=1e-12)


def test_a_singular_chain_is_an_error() -> None:
    normal, _, _ = random_normal(0, 3, 2, 0)
    normal.diagonal[0] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        eliminate(normal)
