"""RTKLIB solution files (.pos; RTKLIB manual 2.4.2, B.3): positions of the antenna with quality flag and sigmas.

    % (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
    %  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m) ...
    2019/06/14 00:00:00.000   49.002011153    8.429826219   116.1040   1  12   0.0051   0.0043   0.0102 ...

Latitude and longitude in degrees or degrees, minutes, seconds; or x, y, z. Times of GPST, UTC or JST, as date or week.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pyproj import Transformer

from conetl.geometry.geodesy import ecef_R_enu
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.readers.trajectories.recorded import Axes, Reading, Records
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import Column, TableLayout, table_records
from conetl.readers.trajectories.text import head_lines

_SCALES = {"GPST": "gps", "UTC": "UTC", "JST": "Asia/Tokyo"}
_SYSTEM = re.compile(r"%\s*(GPST|UTC|JST)\b")
_NAME = re.compile(r"([A-Za-z/-]+)\((?:[^()]*)\)|\b(Q|ns|ratio)\b")
_ROLES = {
    "latitude": "lat", "longitude": "lon", "height": "height", "x-ecef": "x", "y-ecef": "y", "z-ecef": "z", "Q": "quality",
    "sdn": "sigma_n", "sde": "sigma_e", "sdu": "sigma_u", "sdx": "sdx", "sdy": "sdy", "sdz": "sdz", "sdxy": "sdxy",
    "sdyz": "sdyz", "sdzx": "sdzx",
}  # fmt: skip
SINGLE_SIGMA_M = (5.0, 5.0, 10.0)
"""The least sigmas of Q=5: RTKLIB computes those of single solutions from assumed noise, without the errors of the atmosphere."""


def header_of(lines: list[str]) -> int | None:
    """Index of the line with the names of the columns, None without one."""
    units = re.compile(r"\(deg|\(d'|\(m\)")
    return next((i for i, line in enumerate(lines) if _SYSTEM.match(line) and units.search(line)), None)


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of a solution file. Raises InputError."""
    lines = head_lines(path)
    at = header_of(lines)
    if at is None:
        raise InputError(
            f"{path}: there is no line like '%  GPST  latitude(deg) longitude(deg)  height(m)  Q ...', without which times and "
            "coordinates are ambiguous; write the solution with its header (out-outhead=on)"
        )
    header = lines[at]
    if "baseline" in header:
        raise InputError(
            f"{path}: contains vectors from a base (e/n/u-baseline), not positions; set out-solformat to llh and convert it again"
        )
    note = " ".join(line for line in lines[:at] if line.startswith("%"))
    data = next((line for line in lines[at + 1 :] if line.strip() and not line.startswith("%")), "")
    layout = _layout(header, data, at + 2, path)
    if layout.axes == "geocentric":
        return Reading(table_records(path, layout, settings, _of_ecef), "geocentric")
    records = table_records(path, layout, settings, _by_quality)
    return Reading(records, heights="sea level" if "/geodetic" in note else "ellipsoidal")


def _layout(header: str, data: str, first_line: int, path: Path) -> TableLayout:
    """Where the columns are, which depends on the delimiter and on whether the time is a date."""
    system = _SYSTEM.match(header)
    scale = _SCALES[system[1] if system else "GPST"]
    delimiter = next((mark for mark in ",;\t" if mark in data), None)
    calendar = "/" in data.split(delimiter, maxsplit=1)[0] if data.strip() else True
    if not calendar:
        columns = {"week": Column(0, "week"), "time": Column(1, scale, unit="s")}
    elif delimiter is None:
        columns = {"date": Column(0, scale), "time": Column(1, scale)}
    else:
        columns = {"time": Column(0, scale)}
    at = len(columns)
    for match in _NAME.finditer(header):
        name, dms = match[1] or match[2], "d'" in match[0]
        if name in _ROLES:
            columns[_ROLES[name]] = Column(at, match[0], dms=dms)
        at += 3 if dms else 1
    axes: Axes = "geocentric" if {"x", "y", "z"} <= columns.keys() else "geodetic"
    if axes == "geodetic" and not {"lat", "lon", "height"} <= columns.keys():
        raise InputError(f"{path}: expected latitude, longitude and height, or x, y, z-ecef in {header[:200]!r}")
    return TableLayout(columns, axes, first_line, delimiter, scale=scale)


def _by_quality(values: Mapping[str, Floats], found: Records) -> Records:
    """Without records that are not solutions, with the least sigmas of single ones."""
    quality = values.get("quality")
    if quality is None:
        return found
    wrong = dict.fromkeys(np.flatnonzero(~(quality >= 1)).tolist(), "Q states that there is no solution") | found.wrong
    single = quality == 5
    sigma = found.sigma.copy()
    sigma[single, :3] = np.fmax(sigma[single, :3], SINGLE_SIGMA_M)
    return found._replace(sigma=sigma, wrong=wrong)


def _of_ecef(values: Mapping[str, Floats], found: Records) -> Records:
    """With sigmas of east, north, up from the covariance of x, y, z, whose roots RTKLIB writes with their signs."""
    if "sdx" in values:
        order = [["sdx", "sdxy", "sdzx"], ["sdxy", "sdy", "sdyz"], ["sdzx", "sdyz", "sdz"]]
        none = np.zeros(len(found.times_ns))
        roots = np.array([[values.get(name, none) for name in row] for row in order])
        covariance = np.moveaxis(np.sign(roots) * roots**2, -1, 0)
        x, y, z = found.positions.T
        lon, lat, _ = Transformer.from_crs(4978, 4979, always_xy=True).transform(x, y, z)
        turn = ecef_R_enu(np.asarray(lat), np.asarray(lon))
        with np.errstate(invalid="ignore"):
            variances = np.einsum("nji,njk,nki->ni", turn, covariance, turn)
            sigma = found.sigma.copy()
            sigma[:, :3] = np.sqrt(np.where(variances > 0.0, variances, np.nan))
        found = found._replace(sigma=sigma)
    return _by_quality(values, found)
