"""Local trajectories on the earth, against PROJ's own topocentric conversion and against plain geometry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry.georeference import ecef_R_enu, local_to_map, sensor_R_body

ANGLE = st.floats(-math.pi, math.pi)


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


def test_the_x_axis_has_the_heading_in_the_map() -> None:
    lat, lon = 48.0, 11.9  # 2.9 degrees off the central meridian: grid north is 2.2 degrees off
    srid = 32632
    pose = local_to_map(srid, lat, lon, 500.0, 30.0, np.eye(4))[0]
    azimuth = math.degrees(math.atan2(pose[0, 0], pose[1, 0]))
    convergence = math.degrees(float(geodesy.grid_convergence_rad(srid, lat, lon)))
    assert convergence > 2.0
    assert azimuth == pytest.approx(30.0 - convergence, abs=1e-6)
    # and it is where one gets by going along it
    ahead = local_to_map(srid, lat, lon, 500.0, 30.0, se3.se3(np.eye(3), [100.0, 0.0, 0.0]))[0]
    way = ahead[:3, 3] - pose[:3, 3]
    assert math.degrees(math.atan2(way[0], way[1])) == pytest.approx(azimuth, abs=0.01)


@settings(max_examples=30, deadline=None)
@given(st.floats(-80, 80), st.floats(-180, 180))
def test_east_north_up_is_a_rotation(lat: float, lon: float) -> None:
    assert se3.is_rotation(ecef_R_enu(lat, lon))


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
