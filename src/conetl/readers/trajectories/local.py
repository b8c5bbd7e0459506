"""Poses in a local level frame: TUM files and data.csv of EuRoC folders.

    TUM    # timestamp tx ty tz qx qy qz qw                                    seconds since 1970 (Sturm et al., IROS 2012)
    EuRoC  #timestamp,p_RS_R_x [m],...,q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []  nanoseconds since 1970 (Burri et al., IJRR 2016)

Columns are read by their order. drive.yaml gives the position of the frame on the earth (`georeference`) and the sigmas.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from conetl.readers.trajectories.recorded import Reading
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.tables import Column, TableLayout, table_records
from conetl.readers.trajectories.text import floats
from conetl.readers.trajectories.times import TimeFormat


def looks_like_euroc(lines: list[str]) -> bool:
    """Whether the first lines are those of a EuRoC trajectory: 19-digit times, and eight or more numbers."""
    rows = [line.split(",") for line in lines if line.strip() and not line.startswith("#")][:5]
    return bool(rows) and all(len(row) >= 8 and len(row[0].strip()) == 19 and row[0].strip().isdigit() for row in rows)


def looks_like_tum(lines: list[str]) -> bool:
    """Whether the first lines are a time since 1970, three numbers and a quaternion of about unit length."""
    rows = [floats(line.split()) for line in lines if line.strip() and not line.startswith("#")][:5]
    return bool(rows) and all(
        len(row) == 8 and 6e8 < row[0] < 4.2e9 and abs(float((row[4:] ** 2).sum()) - 1.0) < 2e-2 for row in rows
    )


def _read(
    path: Path, settings: TrajectoryFile, *, names: tuple[str, ...], delimiter: str | None, clock: TimeFormat
) -> Reading:
    columns = {"time": Column(0, "timestamp")} | {name: Column(i, name) for i, name in enumerate(names, 1)}
    return Reading(
        table_records(path, TableLayout(columns, "local", 1, delimiter, clock=clock), settings), axes="local"
    )


#: The poses of a data.csv, and those of a TUM file.
read_euroc = partial(
    _read, names=("x", "y", "z", "qw", "qx", "qy", "qz"), delimiter=",", clock=TimeFormat("UTC", "unix", 0)
)
read_tum = partial(
    _read, names=("x", "y", "z", "qx", "qy", "qz", "qw"), delimiter=None, clock=TimeFormat("UTC", "unix")
)
