"""Least squares over a chain of states, each tied to the next, with a few shared unknowns.

The normal matrix is block tridiagonal with a border ("arrow"): blocks are eliminated one after the other (Golub & Van Loan 2013,
4.5.1), the border by its Schur complement, in time linear in the number of states. Covariances of any two states follow from the
same elimination (Rauch, Tung & Striebel 1965 in information form). LAPACK's banded Cholesky gives the same, but its threads cost
up to three seconds per call on a busy machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from conetl.model.arrays import Floats


@dataclass(frozen=True)
class ChainNormal:
    """Normal equations: K states of n unknowns, m shared ones."""

    diagonal: Floats
    """(K, n, n)"""
    upper: Floats
    """(K - 1, n, n): block of state k and state k + 1."""
    border: Floats
    """(K, n, m): block of state k and the shared unknowns."""
    corner: Floats
    """(m, m)"""
    right: Floats
    """(K, n)"""
    right_shared: Floats
    """(m,)"""


@dataclass(frozen=True)
class ChainCovariance:
    """Covariance of all states: `cov[k]`, and by `cross_covariance` of any two."""

    cov: Floats
    """(K, n, n), the shared unknowns' part included."""
    gain: Floats
    """(K - 1, n, n): regression of state k on state k + 1, shared unknowns held."""
    chain: Floats
    """(K, n, n): covariance with the shared unknowns held."""
    reach: Floats
    """(K, n, m): derivative of a state by the shared unknowns."""
    shared: Floats
    """(m, m): covariance of the shared unknowns."""
    strides: tuple[tuple[int, Floats], ...] = ()
    """Steps s of many states, longest first, with (K - s, n, n): gain[k] @ ... @ gain[k + s - 1]."""


def solve(normal: ChainNormal) -> tuple[Floats, Floats]:
    """The solution: (K, n) of the states and (m,) of the shared unknowns. Raises LinAlgError where it is not unique."""
    inverse, gain = _eliminate(normal)
    alone, reach = _chain_solutions(normal, inverse, gain)
    if not len(normal.right_shared):
        return alone, np.zeros(0)
    common = np.linalg.solve(*_shared_normal(normal, alone, reach))
    return alone - reach @ common, np.asarray(common)


def covariance(normal: ChainNormal) -> ChainCovariance:
    """Covariances of the solution (inverse of the normal matrix), in time and memory linear in K."""
    inverse, gain = _eliminate(normal)
    chain = inverse.copy()
    for k in range(len(gain) - 1, -1, -1):
        block = chain[k] + gain[k] @ chain[k + 1] @ gain[k].T
        chain[k] = (block + block.T) / 2
    alone, reach = _chain_solutions(normal, inverse, gain)
    shared: Floats = np.zeros((0, 0))
    if len(normal.right_shared):
        shared = np.asarray(np.linalg.inv(_shared_normal(normal, alone, reach)[0]), dtype=np.float64)
        shared = (shared + shared.T) / 2
    cov = chain + reach @ shared @ np.swapaxes(reach, 1, 2)
    return ChainCovariance(cov, gain, chain, -reach, shared, _strides(gain))


def with_common_errors(result: ChainCovariance, reach: Floats, sigma: Floats) -> ChainCovariance:
    """The covariance plus errors that all states share and the observations do not show.

    reach (K, n, c): change of each state by one of c independent errors; sigma (c,). These are the "considered" parameters of
    Schmidt (1966).
    """
    shared = np.zeros((result.shared.shape[0] + len(sigma),) * 2)
    known = len(result.shared)
    shared[:known, :known], shared[known:, known:] = result.shared, np.diag(sigma**2)
    cov = result.cov + (reach * sigma**2) @ np.swapaxes(reach, 1, 2)
    return replace(result, cov=cov, reach=np.concatenate([result.reach, reach], axis=2), shared=shared)


def cross_covariance(result: ChainCovariance, first: int, second: int) -> Floats:
    """(n, n) covariance of state `first` with state `second`; first <= second. Takes time O(log(second - first))."""
    block, k = result.chain[second], second
    for step, product in (*result.strides, (1, result.gain)):
        while k - step >= first:
            k -= step
            block = product[k] @ block
    return np.asarray(block + result.reach[first] @ result.shared @ result.reach[second].T)


def joint_covariance(result: ChainCovariance, states: Sequence[int], unknowns: int) -> Floats:
    """(S u, S u) covariance of the first u unknowns of S states together; states: rising, each once.

    One walk along the chain from the last of them to the first, for all pairs at once.
    """
    count, size = len(states), result.chain.shape[1]
    blocks = np.zeros((count, count, unknowns, unknowns))
    later = np.zeros((count, size, size))  # of the state at hand with each of the chosen ones from it on
    met = count
    for k in range(states[-1], states[0] - 1, -1) if count else ():
        later[met:] = result.gain[k] @ later[met:] if met < count else later[met:]
        if states[met - 1] == k:
            met -= 1
            later[met] = result.chain[k]
            blocks[met, met:] = later[met:, :unknowns, :unknowns]
            blocks[met:, met] = np.swapaxes(later[met:, :unknowns, :unknowns], 1, 2)
    reach = result.reach[list(states), :unknowns]
    blocks += np.einsum("aim,mn,bjn->abij", reach, result.shared, reach, optimize=True)
    joint = blocks.transpose(0, 2, 1, 3).reshape(count * unknowns, count * unknowns)
    return np.asarray((joint + joint.T) / 2)


def _strides(gain: Floats) -> tuple[tuple[int, Floats], ...]:
    """Products of 16, 256, ... gains in a row from every state on; see `ChainCovariance.strides`."""
    strides: list[tuple[int, Floats]] = []
    step, product = 1, gain
    while len(gain) >= 16 * step:
        for _ in range(4):  # a product twice as long from every state where one fits
            product = product[: len(product) - step] @ product[step:]
            step *= 2
        strides.insert(0, (step, product))
    return tuple(strides)


def _eliminate(normal: ChainNormal) -> tuple[Floats, Floats]:
    """Inverse (K, n, n) of each diagonal block after elimination of the states before it, and gains (K - 1, n, n)."""
    inverse, gain = np.empty_like(normal.diagonal), np.empty_like(normal.upper)
    inverse[0] = np.linalg.inv(normal.diagonal[0])
    for k in range(len(gain)):
        gain[k] = -inverse[k] @ normal.upper[k]
        reduced = normal.diagonal[k + 1] + normal.upper[k].T @ gain[k]
        inverse[k + 1] = np.linalg.inv((reduced + reduced.T) / 2)
    return inverse, gain


def _chain_solutions(normal: ChainNormal, inverse: Floats, gain: Floats) -> tuple[Floats, Floats]:
    """Chain solved for the right side (K, n) and for the columns of the border (K, n, m)."""
    columns = np.concatenate([normal.right[:, :, None], normal.border], axis=2)
    for k in range(len(gain)):
        columns[k + 1] += gain[k].T @ columns[k]
    columns[-1] = inverse[-1] @ columns[-1]
    for k in range(len(gain) - 1, -1, -1):
        columns[k] = inverse[k] @ columns[k] + gain[k] @ columns[k + 1]
    return columns[:, :, 0], columns[:, :, 1:]


def _shared_normal(normal: ChainNormal, alone: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """Schur complement (m, m) and right side (m,) of the shared unknowns."""
    matrix = normal.corner - np.einsum("kni,knj->ij", normal.border, reach)
    return matrix, normal.right_shared - np.einsum("kni,kn->i", normal.border, alone)
