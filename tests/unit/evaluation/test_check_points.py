"""Check points: residuals and RMSE against an independent computation, in any CRS."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from conetl.evaluation.truth import check_map, read_truth_cones
from conetl.model.errors import InputError
from conetl.readers.surveyed_points import read_surveyed_points
from tests import records
from tests.command import ROOT

SRID = 32632
ORIGIN = np.array([458300.0, 5427840.0, 116.0])


HEADER = "name,easting,northing,height_m,sigma_e_m,sigma_n_m,sigma_u_m"


def points_file(path: Path, xyz: np.ndarray, header: str = HEADER) -> Path:
    rows = [f"P{n},{e:.9f},{no:.9f},{h:.5f},0.01,0.01,0.02" for n, (e, no, h) in enumerate(xyz)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_rmse_and_nees_equal_an_independent_computation(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    truth = ORIGIN + np.column_stack([10.0 * np.arange(40), np.zeros(40), np.zeros(40)])
    errors = rng.normal(size=(40, 3)) * np.hypot(0.03, [0.01, 0.01, 0.02])
    cov_m2 = records.cov_of(0.03)
    places = (truth + errors).tolist()
    features = [records.feature(f"cone {n}", **records.standing_at(places[n], cov_m2=cov_m2)) for n in range(36)]
    points = read_surveyed_points(points_file(tmp_path / "points.csv", truth), SRID, crs=f"EPSG:{SRID}")
    checked = check_map(points, features)
    assert [r.feature is None for r in checked.residuals] == [False] * 36 + [True] * 4
    e = errors[:36]
    expected = np.sqrt([*(e**2).mean(0), (e[:, :2] ** 2).sum(1).mean(), (e**2).sum(1).mean()])
    assert checked.rmse_m == pytest.approx(expected, abs=2e-5)
    assert checked.mean_m == pytest.approx(e.mean(0), abs=2e-5)
    variances = 0.03**2 + np.array([0.01, 0.01, 0.02]) ** 2
    assert checked.nees == pytest.approx((e**2 / variances).mean(), rel=1e-2)
    assert not checked.contradicts
    moved = [records.feature(f"cone {n}", **records.standing_at(tuple(truth[n] + [0.0, 0.0, 0.2]), cov_m2=records.cov_of(0.03)))
             for n in range(5)]  # fmt: skip
    assert check_map(points, moved).contradicts
    assert check_map(points, []).rmse_m is None


def test_points_in_another_crs_are_the_same_points(tmp_path: Path) -> None:
    xyz = ORIGIN + np.array([[0.0, 0.0, 0.0], [30.0, -12.0, 1.5]])
    lon, lat = Transformer.from_crs(SRID, 4326, always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    file = points_file(
        tmp_path / "points.csv",
        np.column_stack([lon, lat, xyz[:, 2]]),
        "id,lon,lat,height_m,sigma_e_m,sigma_n_m,sigma_u_m",
    )
    found = read_surveyed_points(file, SRID, crs="EPSG:4979")
    assert np.array([point.xyz_m for point in found]) == pytest.approx(xyz, abs=1e-3)
    assert found[1].name == "P1"


def test_the_truth_of_a_sample_drive_is_a_file_of_points() -> None:
    path = ROOT / "data/drives/2026-03-02_taper_pass1/truth.csv"
    found = read_surveyed_points(path, SRID, crs=f"EPSG:{SRID}", sigma_m=0.01)
    assert [(point.name, point.xyz_m) for point in found] == [
        (cone.cone_id, pytest.approx(cone.xyz_m, abs=1e-4)) for cone in read_truth_cones(path)[0]
    ]


@pytest.mark.parametrize(
    ("header", "options", "message"),
    [
        ("name,easting,northing,height_m,a,b,c", {"crs": "EPSG:32632"}, "does not state the sigmas of the survey"),
        (
            "name,easting,northing,high,sigma_e_m,sigma_n_m,sigma_u_m",
            {"crs": "EPSG:32632"},
            "row 1: a point needs",
        ),
        (HEADER, {}, "does not state a coordinate reference system"),
        (
            "name,easting,northing,height_m,sigma_e_m,sigma_n_m,sigma_u_m",
            {"crs": "mine"},
            "crs: 'mine' is not a coordinate reference system",
        ),
        (
            "name,easting,northing,height_m,sigma_e_m,sigma_n_m,sigma_u_m",
            {"crs": "EPSG:25832", "heights": "EPSG:5773"},
            "grid",
        ),
    ],
)
def test_what_is_missing_is_named(header: str, options: dict[str, str], message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        read_surveyed_points(points_file(tmp_path / "points.csv", ORIGIN[None], header), SRID, **options)
