"""Files in another CRS, compared with an independent reading of the tables: positions, covariances, old positions and heights."""

from __future__ import annotations

import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely
from pyproj import Transformer

from conetl.exports.export import export_map
from conetl.exports.source import ExportContent, ExportRequest
from conetl.model.base import utc_from_ns
from tests.integration.map_by_tables import Instant, MapByTables

#: The neighbouring zone: 6 degrees of longitude away, where the grid is rotated by 4.5 degrees.
OTHER = 25833


@pytest.fixture
def moved(conn, samples):
    """One cone that moved and one that was confirmed, with covariances that are not round."""
    cov_m2 = (0.04, 0.012, 0.003, 0.01, -0.002, 0.09)
    one, two = (samples.feature(name, cov_m2=cov_m2) for name in ("one", "two"))
    two = two.model_copy(update={"xyz_m": (458_021.0, 5_428_015.0, 113.25)})
    samples.commit(conn, samples.added(one), samples.added(two), key="1")
    aside = {"xyz_m": (458_002.5, 5_428_011.0, 114.75), "cov_m2": (0.02, -0.005, 0.001, 0.03, 0.004, 0.05)}
    later = samples.START_NS + samples.DAY_NS
    samples.commit(
        conn,
        samples.changed("moved", one, later, **aside),
        samples.changed("confirmed", two, later, observation_count=7),
        key="2",
    )
    return utc_from_ns(samples.START_NS + samples.DAY_NS // 2)


def turn_at(to_other, xyz_m):
    """(2, 2) rotation of the horizontal axes: the one that is nearest to the numerical Jacobian of the transformation."""
    x, y, _ = xyz_m
    sides = [
        np.subtract(to_other.transform(x + dx, y + dy), to_other.transform(x - dx, y - dy))
        for dx, dy in ((1, 0), (0, 1))
    ]
    u, _, v = np.linalg.svd(np.column_stack(sides) / 2)
    return u @ v


def covariance(one, turn):
    xx, xy, xz, yy, yz, zz = one.cov_m2
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    axes = np.eye(3)
    axes[:2, :2] = turn
    return axes @ full @ axes.T


@pytest.mark.parametrize("what", [ExportContent.FEATURES, ExportContent.CHANGES])
def test_positions_and_covariances_are_those_of_the_other_crs(conn, moved, tmp_path, what):
    tables, to_other = MapByTables(conn, "default"), Transformer.from_crs(32632, OTHER, always_xy=True)
    path = tmp_path / "map.parquet"
    since = {"since": moved} if what is ExportContent.CHANGES else {}
    export_map(conn, path, "geoparquet", ExportRequest(what=what, crs=(OTHER, None), **since))
    rows = {row["feature_id"]: row for row in pq.read_table(path).to_pylist()}
    before, after = tables.standing(Instant(moved)), tables.standing(Instant())
    assert rows.keys() == after.keys() and len(rows) == 2
    for key, row in rows.items():
        one, place = after[key], shapely.from_wkb(row["geometry"])
        assert (place.x, place.y) == pytest.approx(to_other.transform(*one.xyz_m[:2]), abs=1e-6)
        assert place.z == row["ground_height_m"] == pytest.approx(one.xyz_m[2], abs=1e-6)
        cov = covariance(one, turn_at(to_other, one.xyz_m))
        stated = [row[f"sigma_{axis}_m"] ** 2 for axis in "enu"] + [
            row[f"cov_{axes}_m2"] for axes in ("en", "eu", "nu")
        ]
        assert stated == pytest.approx([*np.diag(cov), cov[0, 1], cov[0, 2], cov[1, 2]], abs=1e-7)
        assert (row["version"], row["seen_count"]) == (one.version, one.seen)
        if what is ExportContent.CHANGES:
            old = before[key]
            assert (row["old_easting_m"], row["old_northing_m"]) == pytest.approx(
                to_other.transform(*old.xyz_m[:2]), abs=1e-6
            )
            assert row["old_ground_height_m"] == pytest.approx(old.xyz_m[2], abs=1e-6)
    turned = np.degrees(np.arctan2(*turn_at(to_other, one.xyz_m)[0, ::-1]))
    assert abs(turned) > 2, "rotated enough for the test to notice"
