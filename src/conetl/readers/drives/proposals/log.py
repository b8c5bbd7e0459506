"""The trajectory of a folder for `conetl init`: which file, and what it does not state."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import validated
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.readers.drives import pose_rows
from conetl.readers.drives.camera_files import names_in
from conetl.readers.drives.proposals.proposal import TABLE_SUFFIXES, Proposal, value_at
from conetl.readers.drives.proposals.template import Missing
from conetl.readers.trajectories import read_trajectory, trajectory_format
from conetl.readers.trajectories.recorded import RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile

#: Assumptions about a table that does not state its time scale or heights.
_TAKEN = {
    "time": "times taken as UTC; if they are local or GPS times, set trajectory.time, like Europe/Berlin or gps",
    "heights": "heights taken as ellipsoidal; if they are not, set trajectory.heights, like EPSG:7837",
}
#: Keys that a trajectory may need: the error of its reader says how to state them in drive.yaml.
_UNSTATED = ("columns", "date", "time", "crs", "heights")
#: What is tried, and proposed, for keys that a table does not state.
_TRIED = {"time": "utc", "heights": "ellipsoidal"}
_TIME_OF_DAY = re.compile(r"found '\d\d?:\d\d")
#: What those errors advise, which a template has its own place for.
_REMEDY = re.compile(r"(?:[:;.?]) (?:put|name them) (?=.*drive\.yaml)", re.IGNORECASE)


def add_trajectory(root: Path, proposal: Proposal) -> RecordedTrajectory | None:
    """The trajectory as far as it can be read; what it does not state is missing."""
    settings = proposal.settings.setdefault("trajectory", {})
    candidates = pose_rows.find_logs(root) if "file" not in settings else []
    candidates = [path for path in candidates if path != root / str(proposal.settings["images"].get("timestamps"))]
    if len(candidates) == 1:
        settings["file"] = candidates[0].relative_to(root).as_posix()
    elif "file" not in settings:
        names = ", ".join(path.relative_to(root).as_posix() for path in candidates) or "none was recognised"
        if not candidates and (tables := names_in(root, TABLE_SUFFIXES)):
            names += f"; there is {', '.join(tables)}"
        first = candidates[0].relative_to(root).as_posix() if candidates else None
        proposal.missing.append(Missing("trajectory.file", f"Found: {names}", first))
        return None
    path = root / settings["file"]
    if pose_rows.looks_like(path):
        proposal.found.append(f"trajectory {settings['file']}: poses of the left camera, one row per image")
        _add_local(proposal, "it has no position on the earth")
        _add_sigma(proposal, "it states none")
        return None
    recorded = _read_as_far_as_known(path, settings, proposal)
    if recorded is None:
        return None
    kind = trajectory_format(path) or "table"
    proposal.found.append(_described(recorded, kind))
    proposal.found.extend(recorded.notes)
    if kind == "table":
        proposal.found.extend(f"{recorded.name}: {text}" for key, text in _TAKEN.items() if key not in settings)
    if recorded.is_local:
        _add_local(proposal, f"{settings['file']} has x, y, z in a frame of its own")
    if not np.isfinite(recorded.sigma[:, :2]).any():
        _add_sigma(proposal)
    return recorded


def _add_local(proposal: Proposal, cause: str) -> None:
    if "georeference" not in proposal.settings:
        proposal.missing.append(Missing("georeference", cause))


def _add_sigma(proposal: Proposal, cause: str | None = None) -> None:
    if value_at(proposal.settings, "sigmas.horizontal_m") is None:
        proposal.missing.append(Missing("sigmas.horizontal_m", cause))


def _read_as_far_as_known(path: Path, settings: Mapping[str, Any], proposal: Proposal) -> RecordedTrajectory | None:
    """The trajectory; None where more has to be stated, all of which is missing then: each with the value that is tried."""
    tried = dict(settings)
    while True:
        try:
            return read_trajectory(path, validated(tried, TrajectoryFile, "trajectory"))
        except InputError as error:
            unstated = next((key for key in _UNSTATED if key not in tried and f"{{{key}: " in str(error)), None)
            if unstated is None and _may_be_columns(path, tried, str(error)):
                unstated = "columns"
            if unstated is None:
                if len(tried) == len(settings):
                    raise
                return None  # what was tried may be wrong
            value = _day_of(path) if unstated == "date" else _TRIED.get(unstated)
            proposal.missing.append(Missing(f"trajectory.{unstated}", _REMEDY.split(str(error))[0], value))
            if value is None:
                _add_possible(proposal, path, str(error), tried)
                return None
            tried[unstated] = value


def _add_possible(proposal: Proposal, path: Path, error: str, tried: Mapping[str, Any]) -> None:
    """What may be missing, too, of a table whose columns are unknown."""
    if "date" not in tried and _TIME_OF_DAY.search(error):
        cause = "if no column has the day"
        proposal.missing.append(Missing("trajectory.date", cause, _day_of(path), required=False))
    if value_at(proposal.settings, "sigmas.horizontal_m") is None:
        proposal.missing.append(Missing("sigmas.horizontal_m", "if no column has them", required=False))


def _day_of(path: Path) -> str:
    """When a file was changed last (UTC)."""
    return str(np.datetime64(int(path.stat().st_mtime), "s").astype("datetime64[D]"))


def _may_be_columns(path: Path, settings: Mapping[str, Any], error: str) -> bool:
    """Whether other columns of a table may be the remedy of an error of its records, and not another setting that it names."""
    named = any(str(settings[key]) in error for key in _UNSTATED if key in settings)
    is_table = path.is_file() and trajectory_format(path) in {None, "table"}
    return "columns" not in settings and ": no usable pose: line " in error and is_table and not named


def _described(recorded: RecordedTrajectory, kind: str) -> str:
    times_s = (recorded.times_ns - recorded.times_ns[0]) * 1e-9
    rate = f"{1 / np.median(np.diff(times_s)):.3g} Hz" if len(times_s) > 1 else "one record"
    first = f"{utc_from_ns(int(recorded.times_ns[0])):%Y-%m-%d %H:%M:%S.%f}"[:-3]
    attitude = "with attitude" if recorded.rotations is not None else "positions only"
    known = recorded.sigma[np.isfinite(recorded.sigma[:, :2]).all(axis=1), :2]
    sigma = f"sigma {np.median(known):.3g} m" if len(known) else "no sigmas"
    bad = f", {len(recorded.bad):,} bad records" if recorded.bad else ""
    return (
        f"trajectory {recorded.name} ({kind}): {len(times_s):,} records, {rate}, {attitude}, {sigma}, "
        f"{first} UTC for {times_s[-1]:.0f} s{bad}"
    )
