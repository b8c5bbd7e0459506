"""Corners of a board in images, and deformations of a board. Board frame: origin at the first corner, z = 0; metres."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from conetl.model.records import Side

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class BoardView:
    """The corners of the board that one image shows.

    point_ids: (n,) row numbers in the board's points. uv_px: (n, 2), origin at the centre of the top-left pixel.
    """

    pair_index: int
    side: Side
    point_ids: Ints
    uv_px: Array

    def only(self, keep: NDArray[np.bool_]) -> BoardView:
        """The view with the corners of the mask `keep` (n,)."""
        return BoardView(self.pair_index, self.side, self.point_ids[keep], self.uv_px[keep])


def shape_basis(points_m: ArrayLike) -> Array:
    """Orthonormal basis (3n, 3n - 7) of the deformations of n board points (n, 3) that no rigid motion and no scale explains.

    A board's shape and its poses are only determined together up to a similarity; these are the inner constraints of a free
    network (Meissl), with the mean scale held by the nominal points.
    """
    p = np.asarray(points_m, dtype=np.float64)
    centred = p - p.mean(axis=0)
    x, y, z = centred.T
    zero = np.zeros_like(x)
    motions = [
        *(np.tile(axis, (len(p), 1)) for axis in np.eye(3)),
        np.stack([zero, -z, y], axis=1),
        np.stack([z, zero, -x], axis=1),
        np.stack([-y, x, zero], axis=1),
        centred,
    ]
    datum = np.stack([m.ravel() for m in motions], axis=1)
    q, _ = np.linalg.qr(datum, mode="complete")
    return np.ascontiguousarray(q[:, 7:])


def pair_indices(views: Iterable[BoardView]) -> list[int]:
    """Numbers of all pairs with a view, ascending."""
    return sorted({view.pair_index for view in views})
