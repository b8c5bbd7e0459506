"""Map projection and grid convergence, checked against points 10 m apart along true north."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry.geodesy import bbox_of_degrees, local_to_map, sensor_R_body
from conetl.model.errors import InputError

ANGLE = st.floats(-math.pi, math.pi)


@given(st.floats(-79, 83), st.floats(-179.9, 179.9), st.floats(-100, 5000))
def test_places_survive_the_round_trip_in_their_utm_zone(lat: float, lon: float, height: float) -> None:
    srid = geodesy.utm_srid(lat, lon)
    assert (srid // 100 == 326) == (lat >= 0)
    back = geodesy.to_geodetic(srid, geodesy.to_map(srid, lat, lon, height))
    assert back[0] == pytest.approx(lat, abs=1e-9)
    assert back[1] == pytest.approx(lon, abs=1e-9)
    assert back[2] == height, "heights stay ellipsoidal"


def test_known_place_in_both_hemispheres() -> None:
    assert geodesy.utm_srid(49.011, 8.423) == 32632
    assert geodesy.utm_srid(-33.86, 151.21) == 32756
    assert geodesy.utm_srid(0.0, 180.0) == 32660
    # The central meridian has easting 500 km; the equator northing 0.
    np.testing.assert_allclose(geodesy.to_map(32632, 0.0, 9.0, 12.5), [500_000.0, 0.0, 12.5], atol=1e-3)


@pytest.mark.parametrize(
    ("srid", "message"),
    [(4326, "not a projected CRS in metres"), (2263, "not a projected CRS in metres"), (999999, "not a known")],
)
def test_what_cannot_be_a_map_crs_is_refused(srid: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        geodesy.check_map_srid(srid)


@pytest.mark.parametrize(
    ("srid", "lat", "lon"),
    [(2056, 46.9, 7.4), (27700, 52.0, -1.0), (3006, 66.0, 22.0), (28992, 52.0, 5.4), (2193, -41.0, 174.0)],
)
def test_grids_of_surveys_are_taken(srid: int, lat: float, lon: float) -> None:
    geodesy.check_scale(srid, lat, lon)


@pytest.mark.parametrize(
    ("srid", "lat", "lon", "message"),
    [
        (3857, 49.011, 8.423, "EPSG:32632"),
        # Europe's statistical grid: directions are wrong by up to half a degree, 20 cm at 15 m, and lengths by little.
        (3035, 40.4, -3.7, r"not conformal.*degrees.*EPSG:326"),
        (3035, 60.2, 24.9, r"not conformal.*degrees.*EPSG:326"),
    ],
)
def test_grids_with_wrong_lengths_or_angles_are_refused(srid: int, lat: float, lon: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        geodesy.check_scale(srid, lat, lon)


def test_heights_without_a_system_are_those_of_wgs_84_in_every_datum() -> None:
    """Not those above the ellipsoid of Bessel, 45 m away."""
    xyz_m = [[500000.0, 5316000.0, 430.0]]
    moved = geodesy.to_crs(xyz_m, 32633, 31287, None)
    expected = Transformer.from_crs(32633, 31287, always_xy=True).transform(500000.0, 5316000.0)
    assert moved[0, 2] == 430.0 and moved[0, :2].tolist() == pytest.approx(expected, abs=0.01)


def test_a_datum_shift_without_its_grid_is_refused() -> None:
    """A shift without the grid has an error of 3 m, more than any sigma of the map."""
    with pytest.raises(InputError, match=r"positions in EPSG:31467 .* need the grid de_adv_BETA2007.tif"):
        geodesy.to_crs([[458330.0, 5427854.0, 115.0]], 32632, 31467, None)


def test_the_poles_have_no_utm_zone() -> None:
    with pytest.raises(ValueError, match="outside UTM"):
        geodesy.utm_srid(85.0, 0.0)


def test_a_place_that_the_crs_cannot_express_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot express"):
        geodesy.to_map(32632, math.inf, 8.4, 0.0)


@settings(max_examples=30, deadline=None)
@given(st.floats(-70, 70), st.floats(-179, 179), st.floats(0, 360), st.floats(-2000, 2000), st.floats(-2000, 2000))
def test_places_are_those_of_a_topocentric_frame(lat: float, lon: float, heading: float, x: float, y: float) -> None:
    srid = geodesy.utm_srid(lat, lon)
    found = local_to_map(srid, lat, lon, 100.0, heading, se3.se3(np.eye(3), [x, y, 3.0]))[0]
    turn = math.radians(90.0 - heading)
    east, north = math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y
    back = Transformer.from_pipeline(
        f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0={lon!r} +lat_0={lat!r} +h_0=100 "
        "+step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    true_lon, true_lat, height = back.transform(east, north, 3.0)
    np.testing.assert_allclose(found[:3, 3], geodesy.to_map(srid, true_lat, true_lon, height), atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(ANGLE, st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_axes_are_renamed_to_those_of_the_camera(yaw: float, pitch: float, roll: float) -> None:
    """However the sensor is built in by right angles, and the camera looks by less: forward, left and up come out."""
    camera_axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])  # body axes seen by a camera
    quarter = round(yaw / (math.pi / 2)) * math.pi / 2
    sensor_R_true = se3.rotation_from_rpy(math.pi / 2, 0.0, quarter)
    body_R_left = se3.rotation_from_rpy(roll, pitch, 0.0) @ camera_axes.T
    found = sensor_R_body(sensor_R_true @ body_R_left)
    assert np.linalg.det(found) == pytest.approx(1.0)
    np.testing.assert_allclose(found, sensor_R_true, atol=1e-9)


def test_a_box_across_180_degrees_has_its_west_beyond_its_east() -> None:
    assert bbox_of_degrees([[8.5, 49.1], [8.4, 49.0]]) == [8.4, 49.0, 8.5, 49.1]
    line = [[179.99985, -16.8, 50.0], [179.99995, -16.9, 51.0], [-179.99995, -16.7, 52.0], [-179.99985, -16.8, 50.0]]
    assert bbox_of_degrees(line) == [179.99985, -16.9, 50.0, -179.99985, -16.7, 52.0]
    assert bbox_of_degrees([[179.9, 1.0], [-180.0, 2.0]]) == [179.9, 1.0, -180.0, 2.0]
