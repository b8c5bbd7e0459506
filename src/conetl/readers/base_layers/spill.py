"""Points sorted into cells on disk, so that a cloud larger than memory can be tiled cell by cell."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from conetl.model.errors import InputError
from conetl.readers.base_layers.point_tiles import CELL_M, Cloud, cell_indices, first_in_voxels, in_z_order

#: More cells than this (800 km^2 all covered) are stray points, not a base layer.
MAX_CELLS = 200_000
#: A cell's file is thinned when it grows beyond this.
_COMPACT_BYTES = 64 << 20
_RECORD = np.dtype([("xy", "<f4", 2), ("z", "<f8"), ("shade", "u1")])


class Spilled(NamedTuple):
    """The cells that were written."""

    cells: list[tuple[int, int]]
    """In Z-order."""
    kept: int
    refused: int
    low_m: tuple[float, float]
    high_m: tuple[float, float]


def spill(clouds: Iterable[Cloud], folder: Path, voxel_m: float, name: str) -> Spilled:
    """Write clouds (map coordinates) into one file per cell, thinned by voxel within each cloud, without invalid points.

    Raises InputError, which names `name`, where no point is left or the points spread too far for a base layer.
    """
    limits: dict[tuple[int, int], int] = {}
    kept = refused = 0
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for cloud in clouds:
        good = np.asarray(np.isfinite(cloud.xyz_m).all(axis=1) & (np.abs(cloud.xyz_m) < 1e8).all(axis=1))
        refused += int(np.count_nonzero(~good))
        part = cloud.take(good)
        part = part.take(first_in_voxels(part.xyz_m, voxel_m))
        if len(part.xyz_m) == 0:
            continue
        kept += len(part.xyz_m)
        low, high = np.minimum(low, part.xyz_m[:, :2].min(axis=0)), np.maximum(high, part.xyz_m[:, :2].max(axis=0))
        for (ix, iy), points in _by_cell(part):
            _append(folder, ix, iy, points, voxel_m, limits)
        if len(limits) > MAX_CELLS:
            raise InputError(
                f"{name}: its points spread over {(high - low)[0] / 1000:.0f} x {(high - low)[1] / 1000:.0f} km. Expected a "
                "base layer of at most a few hundred km^2: remove stray points, or import it in parts"
            )
    if not limits:
        raise InputError(
            f"{name}: none of its points is on the map ({refused:,} have no coordinates in its CRS). Is the CRS right?"
        )
    return Spilled(in_z_order(limits), kept, refused, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])))


def read_cells(folder: Path, cells: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int, Cloud]]:
    """The cells that were written, one in memory at a time."""
    for ix, iy in cells:
        yield ix, iy, _read(_file(folder, ix, iy), ix, iy)


def _by_cell(cloud: Cloud) -> Iterator[tuple[tuple[int, int], Cloud]]:
    index = cell_indices(cloud.xyz_m, CELL_M)
    order = np.lexsort((index[:, 1], index[:, 0]))  # stable: the file's order stays within a cell
    index, cloud = index[order], cloud.take(order)
    starts = np.flatnonzero(np.any(np.diff(index, axis=0, prepend=index[:1] - 1) != 0, axis=1))
    for start, stop in zip(starts, [*starts[1:], len(index)], strict=True):
        yield (int(index[start, 0]), int(index[start, 1])), Cloud(cloud.xyz_m[start:stop], cloud.shade[start:stop])


def _append(folder: Path, ix: int, iy: int, cloud: Cloud, voxel_m: float, limits: dict[tuple[int, int], int]) -> None:
    path = _file(folder, ix, iy)
    _write(path, ix, iy, cloud, "ab")
    limit = limits.setdefault((ix, iy), _COMPACT_BYTES)
    if path.stat().st_size > limit:
        whole = _read(path, ix, iy)
        _write(path, ix, iy, whole.take(first_in_voxels(whole.xyz_m, voxel_m)), "wb")
        limits[(ix, iy)] = max(_COMPACT_BYTES, 2 * path.stat().st_size)


def _write(path: Path, ix: int, iy: int, cloud: Cloud, mode: str) -> None:
    records = np.empty(len(cloud.xyz_m), _RECORD)
    records["xy"] = cloud.xyz_m[:, :2] - [ix * CELL_M, iy * CELL_M]
    records["z"], records["shade"] = cloud.xyz_m[:, 2], cloud.shade
    with path.open(mode) as file:
        file.write(records.tobytes())


def _read(path: Path, ix: int, iy: int) -> Cloud:
    records = np.frombuffer(path.read_bytes(), _RECORD)
    xy = np.clip(records["xy"].astype(np.float64), 0.0, np.nextafter(CELL_M, 0)) + np.array([ix, iy]) * CELL_M
    return Cloud(np.column_stack([xy, records["z"]]), np.asarray(records["shade"]))


def _file(folder: Path, ix: int, iy: int) -> Path:
    return folder / f"{ix}_{iy}.cell"
