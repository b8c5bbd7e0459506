"""Point clouds as tiles with levels of detail: cells on disk, thinning, levels, and the bytes of a tile.

A cloud may be larger than memory: its points are first sorted into cells on disk (`spill`) and then tiled cell by cell.

Tiles are squares in plan, aligned with the axes of the map's CRS: level 0 has ROOT_M, every further level half of that. A tile
has the points that are the first ones in their voxel of its level's spacing (side / GRID) and in no coarser level: the tiles of
all levels together are the cloud, and those down to any level are an even sample of it (the additive scheme of Schuetz,
*Potree*, 2016, and of COPC). A tile with few points has all remaining ones and no tiles below it.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.packing import vec3
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.errors import InputError

ROOT_M = 4096.0
#: Spacings along a tile's side.
GRID = 128
#: Side of the cells that are tiled one after the other; the tiles of CELL_LEVEL are as large.
CELL_M = 64.0
CELL_LEVEL = 6
#: Tiles of this level, 8 m wide, have all remaining points.
LAST_LEVEL = 9
#: From CELL_LEVEL on, tiles with at most this many points have all remaining ones.
LEAF_POINTS = 20_000
_STEPS = 65_535
#: Coordinates are rounded to this share of the voxel size.
_ROUNDING = 1 / 16
#: More cells than this (800 km^2 all covered) are stray points, not a base layer.
MAX_CELLS = 200_000
#: A cell's file is thinned when it grows beyond this.
_COMPACT_BYTES = 64 << 20
_RECORD = np.dtype([("xy", "<f4", 2), ("z", "<f8"), ("shade", "u1")])


class Cloud(NamedTuple):
    """xyz_m (N, 3) in the map's CRS; shade (N,) uint8, dark to bright (intensity)."""

    xyz_m: Floats
    shade: NDArray[np.uint8]

    def take(self, index: NDArray[np.integer] | Bools) -> Cloud:
        """The points of an index or mask."""
        return Cloud(self.xyz_m[index], self.shade[index])


class Tile(NamedTuple):
    """One tile; a point is origin_m + steps * scale_m. `payload` is the result of `encode_points`."""

    level: int
    ix: int
    iy: int
    points: int
    origin_m: tuple[float, float, float]
    scale_m: tuple[float, float, float]
    high_m: float
    """Height of its highest point; its lowest is origin_m[2]."""
    payload: bytes


def tile_side_m(level: int) -> float:
    """Side of the tiles of a level."""
    return float(ROOT_M / 2**level)


def join(clouds: Iterable[Cloud]) -> Cloud:
    """Several clouds as one."""
    parts = [Cloud(np.zeros((0, 3)), np.zeros(0, np.uint8)), *clouds]
    return Cloud(np.concatenate([p.xyz_m for p in parts]), np.concatenate([p.shade for p in parts]))


def first_in_voxels(xyz_m: Floats, voxel_m: float) -> Ints:
    """Indices, rising, of the first point in every voxel of points (N, 3). Voxels are aligned with the map's origin."""
    voxels = np.floor(xyz_m / voxel_m)
    order = np.lexsort(voxels.T)  # stable
    return np.sort(order[np.any(np.diff(voxels[order], axis=0, prepend=np.inf) != 0, axis=1)])


def cell_indices(xyz_m: Floats, side_m: float) -> NDArray[np.int64]:
    """(N, 2) index of the square of this side around each point."""
    return np.floor(xyz_m[:, :2] / side_m).astype(np.int64)


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


def top_level(extent_m: float) -> int:
    """The first level of a cloud of this extent: the finest whose tiles are as large as the cloud."""
    return max((level for level in range(CELL_LEVEL + 1) if tile_side_m(level) >= extent_m), default=0)


def tiles_of(cells: Iterable[tuple[int, int, Cloud]], top: int, voxel_m: float) -> Iterator[Tile]:
    """Tiles from level `top` on, of cells (ix, iy, points) of CELL_M in Z-order.

    One cell and one open tile per coarse level are in memory. The points of a cell are thinned by voxel_m first.
    """
    coarse = range(top, CELL_LEVEL)
    keys: dict[int, tuple[int, int]] = {}
    waiting: dict[int, list[Cloud]] = {level: [] for level in coarse}

    def close(level: int) -> Iterator[Tile]:
        cloud = join(waiting[level])
        if len(cloud.xyz_m):
            yield encode_tile(level, *keys[level], cloud, voxel_m)
        waiting[level] = []

    for ix, iy, points in cells:
        cloud = points.take(first_in_voxels(points.xyz_m, voxel_m))
        for level in coarse:
            key = (ix >> CELL_LEVEL - level, iy >> CELL_LEVEL - level)
            if keys.get(level, key) != key:
                yield from close(level)
            keys[level] = key
            chosen, cloud = _split(cloud, level)
            waiting[level].append(chosen)
        yield from _fine_tiles(cloud, CELL_LEVEL, ix, iy, voxel_m)
    for level in coarse:
        yield from close(level)


def _split(cloud: Cloud, level: int) -> tuple[Cloud, Cloud]:
    """The points of a level, and the rest."""
    first = first_in_voxels(cloud.xyz_m, tile_side_m(level) / GRID)
    rest = np.ones(len(cloud.xyz_m), bool)
    rest[first] = False
    return cloud.take(first), cloud.take(rest)


def _fine_tiles(cloud: Cloud, level: int, ix: int, iy: int, voxel_m: float) -> Iterator[Tile]:
    if len(cloud.xyz_m) == 0:
        return
    if level == LAST_LEVEL or len(cloud.xyz_m) <= LEAF_POINTS:
        yield encode_tile(level, ix, iy, cloud, voxel_m)
        return
    chosen, rest = _split(cloud, level)
    yield encode_tile(level, ix, iy, chosen, voxel_m)
    quarter = cell_indices(rest.xyz_m, tile_side_m(level + 1)) - [2 * ix, 2 * iy]
    for dx in (0, 1):
        for dy in (0, 1):
            part = rest.take((quarter[:, 0] == dx) & (quarter[:, 1] == dy))
            yield from _fine_tiles(part, level + 1, 2 * ix + dx, 2 * iy + dy, voxel_m)


def encode_tile(level: int, ix: int, iy: int, cloud: Cloud, voxel_m: float) -> Tile:
    """One tile of at least one point inside it."""
    side = tile_side_m(level)
    low, high = cloud.xyz_m.min(axis=0), cloud.xyz_m.max(axis=0)
    origin = np.array([ix * side, iy * side, low[2]])
    span = np.array([side, side, max(high[2] - low[2], 1e-3)])
    scale = np.maximum(span / _STEPS, voxel_m * _ROUNDING)
    steps = np.clip(np.rint((cloud.xyz_m - origin) / scale), 0, _STEPS).astype(np.uint16)
    payload = encode_points(steps, cloud.shade)
    return Tile(level, ix, iy, len(steps), vec3(origin), vec3(scale), float(high[2]), payload)


def encode_points(steps: NDArray[np.uint16], shade: NDArray[np.uint8]) -> bytes:
    """Gzip of: low bytes, then high bytes, of the zigzag differences of x; the same of y and z; then shades. N points, 7 N bytes.

    steps (N, 3). Points are first sorted along the Z-order curve, so that differences are small; equal points give equal bytes.
    """
    order = np.lexsort((shade, steps[:, 2], steps[:, 1], steps[:, 0], _z_order(steps[:, 0], steps[:, 1])))
    planes: list[bytes] = []
    for axis in range(3):
        values = steps[order, axis].astype(np.int32)
        difference = (np.diff(values, prepend=0) + 0x8000) % 0x10000 - 0x8000  # modulo 2^16, as a signed number
        zigzag = (difference << 1 ^ difference >> 15) & 0xFFFF
        planes += [(zigzag & 0xFF).astype(np.uint8).tobytes(), (zigzag >> 8).astype(np.uint8).tobytes()]
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)  # 31: a gzip header without name and time
    return packer.compress(b"".join([*planes, shade[order].tobytes()])) + packer.flush()


def decode_points(payload: bytes) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """steps (N, 3) and shades (N,) of `encode_points`."""
    data = np.frombuffer(zlib.decompress(payload, 31), np.uint8)
    count = len(data) // 7
    steps = np.empty((count, 3), np.uint16)
    for axis in range(3):
        low, high = (data[(2 * axis + i) * count : (2 * axis + i + 1) * count].astype(np.int64) for i in (0, 1))
        zigzag = low | high << 8
        steps[:, axis] = np.cumsum(zigzag >> 1 ^ -(zigzag & 1)) & 0xFFFF
    return steps, data[6 * count :]


def in_z_order(cells: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Cells (ix, iy) along the Z-order curve: those of a coarser tile are consecutive, on every level."""
    index = np.array(list(cells), np.int64)
    shifted = (index + 2**31).astype(np.uint32)  # cells may have negative indices
    return [(ix, iy) for ix, iy in index[np.argsort(_z_order(*shifted.T))].tolist()]


def _z_order(x: NDArray[np.unsignedinteger], y: NDArray[np.unsignedinteger]) -> NDArray[np.uint64]:
    key = np.zeros(len(x), np.uint64)
    wide_x, wide_y = x.astype(np.uint64), y.astype(np.uint64)
    for bit in range(8 * x.dtype.itemsize):
        shift, one = np.uint64(bit), np.uint64(1)
        key |= (wide_x >> shift & one) << np.uint64(2 * bit) | (wide_y >> shift & one) << np.uint64(2 * bit + 1)
    return key
