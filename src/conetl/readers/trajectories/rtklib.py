"""RTKLIB solution files (.pos; RTKLIB manual 2.4.2, B.3): positions of the antenna with quality flag and sigmas.

    % (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
    %  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m) ...
    2019/06/14 00:00:00.000   49.002011153    8.429826219   116.1040   1  12   0.0051   0.0043   0.0102 ...

Latitude and longitude in degrees or degrees, minutes, seconds; or x, y, z. Times of GPST, UTC or JST, as date or week. Another
line with names, as in files that were joined, holds for the records below it.
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
from conetl.readers.trajectories import delimited
from conetl.readers.trajectories.recorded import Reading, Records
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.text import head_lines

_HEADER = re.compile(r"%\s*(?:GPST|UTC|JST)\b.*(?:\(deg|\(d'|\(m\))")
SINGLE_SIGMA_M = (5.0, 5.0, 10.0)
"""The least sigmas of Q=5: RTKLIB computes those of single solutions from assumed noise, without the errors of the atmosphere."""


def looks_like(lines: list[str]) -> bool:
    """Whether one of the first lines names the columns of a solution."""
    return any(map(_HEADER.match, lines))


def read(path: Path, settings: TrajectoryFile) -> Reading:
    """The records of a solution file. Raises InputError."""
    lines = head_lines(path)
    header = next(filter(_HEADER.match, lines), None)
    if header is None:
        raise InputError(
            f"{path}: there is no line like '%  GPST  latitude(deg) longitude(deg)  height(m)  Q ...', without which times and "
            "coordinates are ambiguous; write the solution with its header (out-outhead=on)"
        )
    if "baseline" in header:
        raise InputError(
            f"{path}: contains vectors from a base (e/n/u-baseline), not positions; set out-solformat to llh and convert it "
            "again"
        )
    is_geodetic = any("/geodetic" in line for line in lines[: lines.index(header)] if line.startswith("%"))
    reading = delimited.read(path, settings, kind="rtklib", adjust=_adjusted)
    return reading._replace(heights="sea level") if is_geodetic and reading.axes == "geodetic" else reading


def _adjusted(values: Mapping[str, Floats], found: Records) -> Records:
    """Without records that are not solutions, with the least sigmas of single ones, and those of x, y, z turned."""
    sigma, wrong = found.sigma.copy(), found.wrong
    if "sdx" in values:
        sigma[:, :3] = _of_ecef(values, found.positions)
    if (quality := values.get("quality")) is not None:
        wrong = dict.fromkeys(np.flatnonzero(~(quality >= 1)).tolist(), "Q states that there is no solution") | wrong
        single = quality == 5
        sigma[single, :3] = np.fmax(sigma[single, :3], SINGLE_SIGMA_M)
    return found._replace(sigma=sigma, wrong=wrong)


def _of_ecef(values: Mapping[str, Floats], positions: Floats) -> Floats:
    """Sigmas (N, 3) of east, north, up from the covariance of x, y, z, whose roots RTKLIB writes with their signs."""
    order = [["sdx", "sdxy", "sdzx"], ["sdxy", "sdy", "sdyz"], ["sdzx", "sdyz", "sdz"]]
    none = np.zeros(len(positions))
    roots = np.array([[values.get(name, none) for name in row] for row in order])
    covariance = np.moveaxis(np.sign(roots) * roots**2, -1, 0)
    x, y, z = positions.T
    lon, lat, _ = Transformer.from_crs(4978, 4979, always_xy=True).transform(x, y, z)
    turn = ecef_R_enu(np.asarray(lat), np.asarray(lon))
    with np.errstate(invalid="ignore"):
        variances = np.einsum("nji,njk,nki->ni", turn, covariance, turn)
        return np.sqrt(np.where(variances > 0.0, variances, np.nan))
