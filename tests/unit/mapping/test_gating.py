"""Gating and assignment in groups give what the whole matrices give."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from conetl.mapping.gating import assign, near_pairs

COORDINATES = st.integers(0, 40).map(lambda n: n / 4)
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES), max_size=14).map(lambda rows: np.array(rows).reshape(-1, 2))


@given(POINTS, POINTS, st.sampled_from([0.5, 1.0, 2.5]))
def test_near_pairs_are_those_of_the_whole_matrix(a, b, reach_m):
    rows, columns = near_pairs(a, b, reach_m)
    distances = np.linalg.norm(a[:, None] - b[None], axis=2).reshape(len(a), len(b))
    expected = np.argwhere(distances <= reach_m)
    assert np.column_stack([rows, columns]).tolist() == expected.tolist()


@settings(max_examples=200)
@given(POINTS, POINTS, st.sampled_from([1.0, 3.0]))
def test_groups_cost_no_more_than_the_whole_matrix_and_pair_as_many(a, b, reach_m):
    rows, columns = near_pairs(a, b, reach_m)
    costs = np.linalg.norm(a[rows] - b[columns], axis=1)
    pairs = assign(rows, columns, costs)
    assert len(set(pairs.values())) == len(pairs)
    allowed = dict(zip(zip(rows.tolist(), columns.tolist(), strict=True), costs.tolist(), strict=True))
    assert all(pair in allowed for pair in pairs.items())
    matrix = np.full((len(a), len(b)), 1e6)
    matrix[rows, columns] = costs
    whole = [(i, j) for i, j in zip(*linear_sum_assignment(matrix), strict=True) if matrix[i, j] < 1e6]
    assert len(pairs) == len(whole)
    assert np.isclose(sum(allowed[pair] for pair in pairs.items()), sum(matrix[i, j] for i, j in whole))


def test_nothing_near():
    empty = np.empty((0, 2))
    assert near_pairs(empty, np.ones((3, 2)), 1.0)[0].tolist() == []
    assert assign(np.empty(0, int), np.empty(0, int), np.empty(0)) == {}
