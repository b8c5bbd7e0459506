"""Trajectory files: results of GNSS/INS post-processing, receiver logs, tables. One module per format.

All give a `RecordedTrajectory`. Poses at the exposures of a drive are made of it in `readers/drives/poses.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from conetl.model.errors import InputError
from conetl.readers.trajectories import axes, delimited, gpx, nmea, oxts, rtklib, sbet, tables
from conetl.readers.trajectories.earth import in_wgs84, unstated_heights
from conetl.readers.trajectories.recorded import Reading, RecordedTrajectory, assembled
from conetl.readers.trajectories.settings import FormatName, TrajectoryFile
from conetl.readers.trajectories.text import head_bytes, head_lines

READERS: dict[FormatName, Callable[[Path, TrajectoryFile], Reading]] = {
    "rtklib": rtklib.read, "sbet": sbet.read, "inertial_explorer": partial(delimited.read, kind="inertial_explorer"),
    "nmea": nmea.read, "gpx": gpx.read, "oxts": oxts.read, "euroc": tables.read_euroc, "tum": tables.read_tum,
    "table": delimited.read,
}  # fmt: skip
_SUFFIXES = frozenset({
    ".pos", ".out", ".sbet", ".txt", ".nmea", ".nme", ".log", ".gpx", ".csv", ".tsv", ".tum", ".dat", ".ie", ".asc", ".ubx",
})  # fmt: skip
_TABLE_SUFFIXES = frozenset({".csv", ".tsv"})
_MOST_CANDIDATES = 500


def read_trajectory(
    path: Path, settings: TrajectoryFile | None = None, between_ns: tuple[int, int] | None = None
) -> RecordedTrajectory:
    """The trajectory of a file, or of a folder with OXTS records.

    between_ns: first and last UTC time that are needed; other records are not kept. So a file of a whole day is read for the time
    of one drive. Raises InputError where the format is not recognised or nothing in the file can be used.
    """
    settings = settings or TrajectoryFile()
    if not path.exists():
        raise InputError(
            f"{path}: there is no such file; name the trajectory in drive.yaml (trajectory: {{file: ...}})"
        )
    name = settings.format or ("table" if settings.columns else trajectory_format(path))
    if name is None and path.suffix.lower() in _TABLE_SUFFIXES:
        name = "table"  # whose reader says which columns it found
    if name is None:
        raise InputError(
            f"{path}: this is not a trajectory in a known format ({', '.join(READERS)}); name its columns in drive.yaml "
            "(trajectory: columns) or export it as CSV with time, lat, lon, height"
        )
    if path.is_dir() != (name == "oxts"):
        raise InputError(
            f"{path}: {'a folder' if path.is_dir() else 'a file'} cannot be a trajectory in the format {name}"
        )
    reading = READERS[name](path, settings)
    is_local = reading.axes == "local"
    if is_local and (settings.crs or settings.heights):
        raise InputError(
            f"{path}: x, y, z of the format {name} are local: leave out trajectory.crs and heights in drive.yaml"
        )
    pieces = reading.pieces if is_local else in_wgs84(reading, settings, path)
    with np.errstate(all="ignore"):  # damaged numbers become NaN, and their records bad
        found = assembled(path, pieces, is_local=is_local, between_ns=between_ns, progress=reading.progress)
        return axes.resolved(path, found._replace(notes=tuple(reading.notes)), reading)


def remarks_on(path: Path, settings: TrajectoryFile, *, has_vertical_sigma: bool = False) -> list[str]:
    """What to say of a trajectory file before it is read: heights above the sea or the ellipsoid, a missing end or checksums."""
    name = (settings.format or trajectory_format(path)) if path.is_file() else None
    found = [gpx.cut_note(path) if name == "gpx" else nmea.unchecked_note(path) if name == "nmea" else None]
    known = has_vertical_sigma or settings.heights is not None or settings.crs is not None
    if name == "gpx" and not known and not gpx.states_geoid(path):
        found.append(unstated_heights(path))
    return [note for note in found if note is not None]


def trajectory_format(path: Path) -> FormatName | None:
    """Name of the format of a file or folder by its content, None for anything else. Raises InputError."""
    if path.is_dir():
        return "oxts" if oxts.looks_like(path) else None
    head = head_bytes(path).rstrip(b"\0")  # space may be reserved behind a log
    lines = head_lines(path)
    if "<gpx" in (text := "\n".join(lines)).lower() and text.lstrip("\ufeff \n\t").startswith("<"):
        return "gpx"
    if nmea.looks_like(lines, binary := b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff"))):
        return "nmea"
    if binary:
        return "sbet" if sbet.looks_like(path.stat().st_size, head_bytes(path)) else None
    if rtklib.looks_like(lines):
        return "rtklib"
    if tables.looks_like_euroc(lines):
        return "euroc"
    return "tum" if tables.looks_like_tum(lines) else delimited.kind_of(lines)


def find_trajectories(folder: Path) -> list[Path]:
    """Files (and folders of OXTS records) in a folder, and in its folders, that look like trajectories; sorted by name."""
    folders = [folder, *(path for path in folder.glob("[!.]*") if path.is_dir())]
    found = [f for f in folders if oxts.folder_of(f) == f and oxts.looks_like(f)]
    files = (path for f in folders for path in f.glob("[!.]*") if path.suffix.lower() in _SUFFIXES and path.is_file())
    return sorted(found) + [path for path in sorted(files)[:_MOST_CANDIDATES] if _is_trajectory(path)]


def _is_trajectory(path: Path) -> bool:
    try:
        return trajectory_format(path) is not None
    except InputError:
        return False
