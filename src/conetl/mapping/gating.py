"""Which of many points lie near each other, and the cheapest one-to-one pairing of those that do: nearly linear in their number.

A drive of 100,000 tracks against 100,000 features would need a matrix of ten thousand million costs, nearly all forbidden.
Only pairs within reach are looked at, and points that hang together through such pairs are assigned by themselves, which gives
the same total as the whole matrix would: between such groups nothing is allowed.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
#: Cost of a pair that is not allowed, inside one group; far above any distance.
_FORBIDDEN = 1e6


def near_pairs(a_m: Floats, b_m: Floats, reach_m: float) -> tuple[Indices, Indices]:
    """Indices into a_m (N, 2) and b_m (M, 2), metres, of all pairs at most `reach_m` apart, by rising index of `a`, then `b`."""
    if not len(a_m) or not len(b_m):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    # A hair farther, so that a pair exactly at the reach is not lost to the tree's rounding: callers gate themselves.
    reach_m = reach_m * (1 + 1e-9)
    found = cast("list[list[int]]", cKDTree(b_m).query_ball_point(a_m, reach_m, return_sorted=True))
    counts = np.fromiter((len(indices) for indices in found), np.int64, len(a_m))
    columns = np.fromiter((index for indices in found for index in indices), np.int64, int(counts.sum()))
    return np.repeat(np.arange(len(a_m)), counts), columns


def assign(rows: Indices, columns: Indices, costs: Floats, *, alone_cost: float | None = None) -> dict[int, int]:
    """Row -> column of the one-to-one pairing with most pairs and, among those, the least total cost.

    rows, columns, costs (K,): the pairs that are allowed, each once. A pair whose ends have no other choice costs no assignment.
    alone_cost: what a row and a column cost together that stay alone, above all costs; then not the number of pairs counts, but
    the total of these and of the costs of pairs.
    """
    if not len(rows):
        return {}
    row_ids, r = np.unique(rows, return_inverse=True)
    column_ids, c = np.unique(columns, return_inverse=True)
    alone = (np.bincount(r)[r] == 1) & (np.bincount(c)[c] == 1)
    pairs = dict(zip(rows[alone].tolist(), columns[alone].tolist(), strict=True))
    r, c, costs = r[~alone], c[~alone], costs[~alone]
    size = len(row_ids) + len(column_ids)
    graph = coo_array((np.ones(len(r), bool), (r, len(row_ids) + c)), shape=(size, size))
    group = connected_components(graph, directed=False)[1][r]
    order = np.argsort(group, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1) if len(order) else ():
        rr, i = np.unique(r[members], return_inverse=True)
        cc, j = np.unique(c[members], return_inverse=True)
        forbidden = _FORBIDDEN if alone_cost is None else alone_cost
        matrix = np.full((len(rr), len(cc)), forbidden)
        matrix[i, j] = np.minimum(costs[members], forbidden)
        for k, m in zip(*linear_sum_assignment(matrix), strict=True):
            if matrix[k, m] < forbidden:
                pairs[int(row_ids[rr[k]])] = int(column_ids[cc[m]])
    return pairs
