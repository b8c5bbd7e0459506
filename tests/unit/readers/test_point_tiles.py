"""Tiles of points: nothing is lost but by thinning, every level is an even sample, the bytes come back."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from conetl.readers.base_layers.point_tiles import (
    CELL_M,
    GRID,
    LEAF_POINTS,
    Cloud,
    cell_indices,
    decode_points,
    encode_points,
    first_in_voxels,
    in_z_order,
    join,
    read_cells,
    spill,
    tile_side_m,
    tiles_of,
    top_level,
)

ORIGIN = np.array([458_000.0, 5_428_000.0, 110.0])


def cells_of(cloud):
    index = cell_indices(cloud.xyz_m, CELL_M)
    keys = in_z_order({(int(ix), int(iy)) for ix, iy in index})
    return [(ix, iy, cloud.take((index[:, 0] == ix) & (index[:, 1] == iy))) for ix, iy in keys]


def points_of(tile):
    steps, _ = decode_points(tile.payload)
    return steps * np.array(tile.scale_m) + tile.origin_m


def street(count=90_000, length_m=300.0, seed=1):
    rng = np.random.default_rng(seed)
    xyz = np.column_stack([rng.uniform(0, length_m, count), rng.uniform(-8, 8, count), rng.uniform(0, 0.2, count)])
    return Cloud(xyz + ORIGIN, rng.integers(0, 256, count).astype(np.uint8))


@given(arrays(np.uint16, st.tuples(st.integers(1, 60), st.just(3))), st.randoms(use_true_random=False))
def test_bytes_come_back(steps, random):
    shade = np.array([random.randrange(256) for _ in steps], np.uint8)
    back, tint = decode_points(encode_points(steps, shade))
    wanted = sorted(zip(map(tuple, steps.tolist()), shade.tolist(), strict=True))
    assert sorted(zip(map(tuple, back.tolist()), tint.tolist(), strict=True)) == wanted


@given(arrays(np.uint16, st.tuples(st.integers(1, 40), st.just(3))), st.permutations(range(8)))
def test_equal_points_give_equal_bytes_in_any_order(steps, order):
    shade = (steps[:, 0] % 251).astype(np.uint8)
    turned = np.argsort([order[i % 8] * 100 + i for i in range(len(steps))])
    assert encode_points(steps, shade) == encode_points(steps[turned], shade[turned])


@given(arrays(np.float64, st.tuples(st.integers(0, 80), st.just(3)), elements=st.floats(-50, 50)))
def test_thinning_keeps_the_first_point_of_every_voxel(xyz):
    kept = first_in_voxels(xyz, 1.0)
    voxels = [tuple(v) for v in np.floor(xyz).astype(int).tolist()]
    assert len({voxels[i] for i in kept}) == len(kept) == len(set(voxels))
    assert all(voxels.index(voxels[i]) == i for i in kept)
    assert (first_in_voxels(xyz[kept], 1.0) == np.arange(len(kept))).all()


def test_all_tiles_together_are_the_thinned_cloud():
    cloud, voxel_m = street(), 0.1
    tiles = list(tiles_of(cells_of(cloud), top_level(300.0), voxel_m))
    thinned = join(part.take(first_in_voxels(part.xyz_m, voxel_m)) for _, _, part in cells_of(cloud))
    assert sum(tile.points for tile in tiles) == len(thinned.xyz_m)
    back = np.concatenate([points_of(tile) for tile in tiles])
    order, wanted = (xyz[np.lexsort(np.round(xyz, 1).T)] for xyz in (back, thinned.xyz_m))
    assert len(order) == len(wanted)
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(back).query(thinned.xyz_m)
    assert distance.max() < 0.02  # half a step: the coarsest tiles count in about a centimetre
    assert len({(t.level, t.ix, t.iy) for t in tiles}) == len(tiles)


def test_a_level_is_spaced_as_its_tiles_say_and_lies_inside_them():
    tiles = list(tiles_of(cells_of(street()), top_level(300.0), 0.05))
    assert {tile.level for tile in tiles} >= {3, 4, 5, 6}
    for tile in tiles:
        side, xyz = tile_side_m(tile.level), points_of(tile)
        low = np.array([tile.ix, tile.iy]) * side
        assert (xyz[:, :2] >= low - 1e-6).all() and (xyz[:, :2] <= low + side + 0.05).all()
        assert xyz[:, 2].min() >= tile.origin_m[2] and xyz[:, 2].max() <= tile.high_m + 0.01
        if tile.level < 6:
            assert len(first_in_voxels(xyz, side / GRID)) >= 0.98 * tile.points  # places are rounded
        assert tile.points <= max(LEAF_POINTS, GRID * GRID * 4)


def test_tiles_do_not_depend_on_how_the_points_were_cut_into_chunks(tmp_path):
    cloud, found = street(20_000), []
    for parts in (1, 7):
        folder = tmp_path / str(parts)
        folder.mkdir()
        chunks = (cloud.take(some) for some in np.array_split(np.arange(20_000), parts))
        found.append(list(tiles_of(read_cells(folder, spill(chunks, folder, 0.1, "x").cells), 4, 0.1)))
    assert found[0] == found[1]
