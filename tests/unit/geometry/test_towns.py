"""The towns of the world: those near a place, and those of a name."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Geod

from conetl.geometry.towns import Town, towns_called, towns_near

_GEOD = Geod(ellps="WGS84")


def _away_m(town: Town, lat: float, lon: float) -> float:
    return float(_GEOD.inv(town.lon_deg, town.lat_deg, lon, lat)[2])


@pytest.mark.parametrize(
    ("lat", "lon", "label"),
    [
        (49.002, 8.430, "Karlsruhe, Germany"), (24.79, 120.99, "Hsinchu, Taiwan"), (-33.87, 151.21, "Sydney, Australia"),
        (64.13, -21.9, "Reykjavík, Iceland"), (-16.5, 179.9, "Labasa, Fiji"), (-16.5, -179.9, "Labasa, Fiji"),
    ],
)  # fmt: skip
def test_towns_near_a_place_are_those_within_the_distance_the_largest_first(lat: float, lon: float, label: str) -> None:
    found = towns_near(lat, lon, within_m=80_000.0)
    assert label in [town.label for town in found]
    assert [town.population for town in found] == sorted((town.population for town in found), reverse=True)
    away_m = np.array([_away_m(town, lat, lon) for town in found])
    assert away_m.max() < 80_400.0  # the Earth as a sphere: 0.5 %
    fewer = towns_near(lat, lon, within_m=40_000.0)
    assert {*fewer} <= {town for town, m in zip(found, away_m, strict=True) if m < 40_200.0}
    assert {*fewer} >= {town for town, m in zip(found, away_m, strict=True) if m < 39_800.0}


def test_nothing_is_near_the_open_sea_and_names_count_in_any_case() -> None:
    assert towns_near(0.0, -30.0, within_m=50_000.0) == []
    assert towns_called("kARLSr")[0].label == "Karlsruhe, Germany"
    assert {town.name.casefold()[:5] for town in towns_called("SPRIN")} == {"sprin"}
    assert towns_called("no town of this name") == []
