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
from scipy.linalg import block_diag

from conetl.model.arrays import Floats, Ints


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
class ChainPoints:
    """Normal equations of L points of 3 unknowns each, each tied to some states, by S ties."""

    state: Ints
    """(S,)"""
    point: Ints
    """(S,)"""
    border: Floats
    """(S, p, 3): block of the first p unknowns of a state and a point."""
    corner: Floats
    """(L, 3, 3)"""
    right: Floats
    """(L, 3)"""


@dataclass(frozen=True)
class EliminatedChain:
    """Normal equations after the elimination of one state after the other."""

    inverse: Floats
    """(K, n, n) of each diagonal block without the states before it."""
    gain: Floats
    """(K - 1, n, n): regression of state k on state k + 1, shared unknowns held."""
    alone: Floats
    """(K, n): solution without the shared unknowns."""
    reach: Floats
    """(K, n, m): what a shared unknown takes from it."""
    shared: Floats
    """(m, m): Schur complement of the shared unknowns."""
    right_shared: Floats
    """(m,)"""


@dataclass(frozen=True)
class ChainCovariance:
    """Covariance of all states: `of` one of them, and by `cross_covariance` of any two."""

    gain: Floats
    """(K - 1, n, n): regression of state k on state k + 1, shared unknowns held."""
    chain: Floats
    """(K, n, n): covariance with the shared unknowns held."""
    reach: Floats
    """(K, n, m): derivative of a state by the shared unknowns."""
    shared: Floats
    """(m, m): covariance of the shared unknowns."""
    strides: tuple[tuple[int, Floats], ...] = ()
    """Steps s of many states, longest first, with gain[k] @ ... @ gain[k + s - 1] of each k that is a multiple of s."""

    def of(self, state: int) -> Floats:
        """(n, n): covariance of one state."""
        return np.asarray(self.chain[state] + self.reach[state] @ self.shared @ self.reach[state].T)

    @property
    def variances(self) -> Floats:
        """(K, n)"""
        by_shared = np.einsum("kim,mn,kin->ki", self.reach, self.shared, self.reach, optimize=True)
        return np.asarray(np.diagonal(self.chain, axis1=1, axis2=2) + by_shared)


def eliminate(normal: ChainNormal) -> EliminatedChain:
    """Overwrites the normal equations, of which a long drive has gigabytes. Raises LinAlgError where they are singular."""
    inverse, gain = normal.diagonal, normal.upper
    inverse[0] = np.linalg.inv(inverse[0])
    for k in range(len(gain)):
        upper = gain[k].copy()
        gain[k] = -inverse[k] @ upper
        reduced = inverse[k + 1] + upper.T @ gain[k]
        inverse[k + 1] = np.linalg.inv((reduced + reduced.T) / 2)
    columns = np.concatenate([normal.right[:, :, None], normal.border], axis=2)
    for k in range(len(gain)):
        columns[k + 1] += gain[k].T @ columns[k]
    columns[-1] = inverse[-1] @ columns[-1]
    for k in range(len(gain) - 1, -1, -1):
        columns[k] = inverse[k] @ columns[k] + gain[k] @ columns[k + 1]
    alone, reach = columns[:, :, 0], columns[:, :, 1:]
    shared = normal.corner - np.einsum("kni,knj->ij", normal.border, reach)
    return EliminatedChain(
        inverse, gain, alone, reach, shared, normal.right_shared - np.einsum("kni,kn->i", normal.border, alone)
    )


def solve(chain: EliminatedChain) -> tuple[Floats, Floats]:
    """The solution: (K, n) of the states and (m,) of the shared unknowns. Raises LinAlgError where it is not unique."""
    if not len(chain.shared):
        return chain.alone, np.zeros(0)
    common = np.linalg.solve(chain.shared, chain.right_shared)
    return np.asarray(chain.alone - chain.reach @ common), np.asarray(common)


def with_points(normal: ChainNormal, points: ChainPoints) -> ChainNormal:
    """The same with the points as last shared unknowns, for as many as the covariance shall contain."""
    (count, size), (_, known), unknowns = normal.right.shape, normal.corner.shape, points.right.size
    border, corner = np.zeros((count, size, unknowns)), np.zeros((known + unknowns,) * 2)
    for state, point, block in zip(points.state, points.point, points.border, strict=True):
        border[state, : len(block), 3 * point : 3 * point + 3] += block
    corner[:known, :known] = normal.corner
    for point, block in enumerate(points.corner):
        at = slice(known + 3 * point, known + 3 * point + 3)
        corner[at, at] = block
    return replace(
        normal, border=np.concatenate([normal.border, border], axis=2), corner=corner,
        right_shared=np.concatenate([normal.right_shared, points.right.ravel()]),
    )  # fmt: skip


def solve_with_points(normal: ChainNormal, points: ChainPoints) -> tuple[Floats, Floats, Floats]:
    """The solution: (K, n) of the states, (m,) of the shared unknowns and (L, 3) of the points; 0 for those without a tie.

    Each point is eliminated with the last state that it is tied to (frontal method: Irons 1970), so that time and memory are
    linear in K however many points a long drive has. Raises LinAlgError where the equations are singular.
    """
    (count, size), shared = normal.right.shape, len(normal.right_shared)
    last = np.full(len(points.right), -1)
    np.maximum.at(last, points.point, points.state)
    order = np.argsort(points.state, kind="stable")
    ties = np.split(order, np.searchsorted(points.state[order], np.arange(1, count)))
    front, right = np.zeros((size + shared,) * 2), np.zeros(size + shared)
    front[size:, size:], right[size:] = normal.corner, normal.right_shared
    inside: list[int] = []  # points of the front, after the state and the shared unknowns
    solved: list[tuple[list[int], list[int], Floats, Floats]] = []
    for k in range(count):
        for point in dict.fromkeys(points.point[ties[k]].tolist()):
            if point not in inside:
                inside.append(point)
                front = block_diag(front, points.corner[point])
                right = np.append(right, points.right[point])
        front[:size, :size] += normal.diagonal[k]
        front[:size, size : size + shared] += normal.border[k]
        front[size : size + shared, :size] += normal.border[k].T
        right[:size] += normal.right[k]
        at = {point: size + shared + 3 * place for place, point in enumerate(inside)}
        for tie in ties[k]:
            block, j = points.border[tie], at[int(points.point[tie])]
            front[: len(block), j : j + 3] += block
            front[j : j + 3, : len(block)] += block.T
        gone, stay = [p for p in inside if last[p] == k], [p for p in inside if last[p] > k]
        out = np.r_[:size, [at[point] + axis for point in gone for axis in range(3)]].astype(int)
        rest = np.r_[size : size + shared, [at[point] + axis for point in stay for axis in range(3)]].astype(int)
        beside = np.zeros((len(out), size + len(rest)))
        beside[:size, :size] = normal.upper[k] if k + 1 < count else 0.0
        beside[:, size:] = front[np.ix_(out, rest)]
        columns = np.linalg.solve(front[np.ix_(out, out)], np.column_stack([beside, right[out]]))
        solved.append((gone, stay, columns[:, :-1], columns[:, -1]))
        reduced = -beside.T @ columns[:, :-1]
        reduced[size:, size:] += front[np.ix_(rest, rest)]
        front, right = (reduced + reduced.T) / 2, np.append(np.zeros(size), right[rest]) - beside.T @ columns[:, -1]
        inside = [*stay]
    common = np.linalg.solve(front[size:, size:], right[size:])
    states, places = np.zeros((count + 1, size)), np.zeros_like(points.right)
    for k, (gone, stay, gain, alone) in reversed([*enumerate(solved)]):
        found = alone - gain @ np.concatenate([states[k + 1], common, places[stay].ravel()])
        states[k], places[gone] = found[:size], found[size:].reshape(-1, 3)
    return states[:-1], common, places


def covariance(eliminated: EliminatedChain) -> ChainCovariance:
    """Covariances of the solution (inverse of the normal matrix), in time and memory linear in K; overwrites `inverse`."""
    chain, gain = eliminated.inverse, eliminated.gain
    for k in range(len(gain) - 1, -1, -1):
        block = chain[k] + gain[k] @ chain[k + 1] @ gain[k].T
        chain[k] = (block + block.T) / 2
    shared = np.asarray(np.linalg.inv(eliminated.shared), dtype=np.float64)
    return ChainCovariance(gain, chain, -eliminated.reach, (shared + shared.T) / 2, _strides(gain))


def with_common_errors(result: ChainCovariance, reach: Floats, sigma: Floats) -> ChainCovariance:
    """The covariance plus errors that all states share and the observations do not show.

    reach (K, n, c): change of each state by one of c independent errors; sigma (c,). These are the "considered" parameters of
    Schmidt (1966).
    """
    shared = np.zeros((result.shared.shape[0] + len(sigma),) * 2)
    known = len(result.shared)
    shared[:known, :known], shared[known:, known:] = result.shared, np.diag(sigma**2)
    return replace(result, reach=np.concatenate([result.reach, reach], axis=2), shared=shared)


def cross_covariance(result: ChainCovariance, first: int, second: int) -> Floats:
    """(n, n) covariance of state `first` with state `second`; first <= second. Takes time O(log(second - first))."""
    block, k = result.chain[second], second
    while k > first:
        step, product = next((of for of in result.strides if k % of[0] == 0 and k - of[0] >= first), (1, result.gain))
        k -= step
        block = product[k // step] @ block
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
    """Products of 16, 256, ... gains in a row from every 16th, 256th, ... state on; see `ChainCovariance.strides`."""
    strides: list[tuple[int, Floats]] = []
    step, product = 1, gain
    while len(product) >= 16:
        product = product[: len(product) // 16 * 16]
        for _ in range(4):
            product = product[::2] @ product[1::2]
        step *= 16
        strides.insert(0, (step, product))
    return tuple(strides)
