"""The trajectory and the calibration of a folder for `conetl init`: which files, and what they do not state."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from conetl.files.documents import input_errors, validated
from conetl.geometry import rig as rigs
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.rig import Rig
from conetl.readers.drives import pose_rows
from conetl.readers.drives.camera_files import names_in
from conetl.readers.drives.drive_yaml import DRIVE_YAML, Mount
from conetl.readers.drives.proposals.template import RIG, TABLE_SUFFIXES, Proposal, value_at
from conetl.readers.rigs import RIG_SUFFIXES, RIG_YAML, FoundRigs, find_rigs, read_given_rig
from conetl.readers.trajectories import read_trajectory, trajectory_format
from conetl.readers.trajectories.recorded import RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile

#: Assumptions about a table that does not state its time scale or heights.
_TAKEN = {
    "time": "times taken as UTC; if they are local or GPS times, set trajectory.time, like Europe/Berlin or gps",
    "heights": "heights taken as ellipsoidal; if they are not, set trajectory.heights, like EPSG:7837",
}
#: Keys that a trajectory may need: the error of its reader says how to state them in drive.yaml.
_UNSTATED = ("columns", "date", "time", "crs", "heights", "angles")
#: What is tried, and proposed, for keys that a table does not state.
_TRIED = {"time": "utc", "heights": "ellipsoidal", "angles": "radians"}
_TIME_OF_DAY = re.compile(r"found '\d\d?:\d\d")
#: What those errors advise, which a template has its own place for.
_REMEDY = re.compile(r"(?:[:;.?]) (?:put|name them) (?=.*drive\.yaml)", re.IGNORECASE)


def add_trajectory(root: Path, proposal: Proposal) -> RecordedTrajectory | None:
    """The trajectory as far as it can be read; what it does not state is missing."""
    settings = proposal.settings.setdefault("trajectory", {})
    if "file" not in settings:
        times = root / str(proposal.settings["images"].get("timestamps"))
        names = [path.relative_to(root).as_posix() for path in pose_rows.find_logs(root) if path != times]
        if len(names) != 1:
            found = ", ".join(names) or "none was recognised"
            if not names and (tables := names_in(root, TABLE_SUFFIXES)):
                found += f"; there is {', '.join(tables)}"
            proposal.need("trajectory.file", f"Found: {found}", names[0] if names else None)
            return None
        settings["file"] = names[0]
    path = root / settings["file"]
    if pose_rows.looks_like(path):
        proposal.found.append(f"trajectory {settings['file']}: poses of the left camera, one row per image")
        proposal.need("georeference", "it has no position on the earth")
        proposal.need("sigmas.horizontal_m", "it states none")
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
        proposal.need("georeference", f"{settings['file']} has x, y, z in a frame of its own")
    if not np.isfinite(recorded.sigma[:, :2]).any():
        proposal.need("sigmas.horizontal_m")
    return recorded


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
            changed = str(np.datetime64(int(path.stat().st_mtime), "s").astype("datetime64[D]"))
            value = changed if unstated == "date" else _TRIED.get(unstated)
            proposal.need(f"trajectory.{unstated}", _REMEDY.split(str(error))[0], value)
            if value is None:  # what may be missing, too, of a table whose columns are unknown
                if "date" not in tried and _TIME_OF_DAY.search(str(error)):
                    proposal.need("trajectory.date", "if no column has the day", changed, required=False)
                proposal.need("sigmas.horizontal_m", "if no column has them", required=False)
                return None
            tried[unstated] = value


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


def add_rig(root: Path, rig_file: Path | None, proposal: Proposal, size: tuple[int, int] | None) -> Rig | None:
    """The rig that has to be written; None where it is there, or is not known yet."""
    if rig_file is not None:
        path = rig_file
        rig, kind = read_given_rig(path, size)
    else:
        found, of_other_size, unread = _fitting(root, size, proposal.settings["images"])
        proposal.found.extend(of_other_size)
        if unread and not found and size is None and proposal.missing:
            return None  # one may fit once the size of the images is known
        if not found:
            proposal.found.extend(unread)
        replaces = (root / RIG_YAML).is_file() and RIG_YAML not in (path.name for path, _, _ in found)
        # A file that somebody made is not replaced without being asked.
        if len({_numbers_of(rig) for _, rig, _ in found}) != 1 or replaces:
            names = ", ".join(path.name for path, _, _ in found) or "none that fits"
            cause = f"Found: {names}."
            if not found:
                cause += " 'conetl calibrate' makes one from images of a board."
            if not found and of_other_size and "crop" not in proposal.settings["images"]:
                cause += " If these images are a part of larger ones, or were padded or binned, state images.crop."
            proposal.need(RIG, cause + f" It replaces {RIG_YAML}." * replaces)
            return None
        path, rig, kind = found[0]
    image_size = f"{rig.left.width_px} x {rig.left.height_px}"
    proposal.found.append(f"calibration {path.name} ({kind}): {image_size}, baseline {rig.baseline_m:.3f} m")
    if "mount" in proposal.settings:
        proposal.found.append(_mounted(Mount.model_validate(proposal.settings["mount"])))
    elif rigs.body_is_left_camera(rig):
        log = value_at(proposal.settings, "trajectory.file")
        if log is None or not pose_rows.looks_like(root / log):  # else the poses are those of the left camera
            proposal.need("mount")
    return None if path == root / RIG_YAML else rig


def _fitting(root: Path, size: tuple[int, int] | None, images: Mapping[str, Any]) -> FoundRigs:
    """The calibrations for images of this size, or for larger ones of which these are the stated part."""
    if images.get("crop") is None:
        return rigs_in(root, size)
    found = rigs_in(root, None)
    part = FoundRigs([], [*found.of_other_size], found.unread)
    for path, rig, kind in found.fitting:
        with input_errors(f"{path}: images.crop"):
            camera = rigs.cropped(rig, *images["crop"], binning=images.get("binning", 1)).left
        if size in (None, (camera.width_px, camera.height_px)):
            part.fitting.append((path, rig, kind))
        else:
            part.of_other_size.append(
                f"calibration {path.name}: the stated part of its images has {camera.width_px} x {camera.height_px} pixels, "
                f"these images have {size[0]} x {size[1]}"
            )
    return part


def _numbers_of(rig: Rig) -> tuple[object, ...]:
    """What is equal in two files of one calibration."""
    cameras = (
        (c.width_px, c.height_px, round(c.fx_px, 3), round(c.cx_px, 3), round(c.cy_px, 3))
        for c in (rig.left, rig.right)
    )
    return *cameras, round(rig.baseline_m, 4)


def rigs_in(root: Path, size: tuple[int, int] | None) -> FoundRigs:
    """The calibrations in a folder for images of a size."""
    return find_rigs([root / name for name in names_in(root, RIG_SUFFIXES) if name != DRIVE_YAML], size)


def _mounted(mount: Mount) -> str:
    """A mount in words: a sign the wrong way round is seen there."""
    forward, left, up, pitch = mount.forward_m, mount.left_m, mount.up_m, mount.pitch_deg
    along, aside = "in front of" if forward >= 0 else "behind", "left of" if left >= 0 else "right of"
    over = "above" if up >= 0 else "below"
    place = f"{abs(forward):g} m {along}, {abs(left):g} m {aside} and {abs(up):g} m {over} the antenna or IMU"
    turned = f", yaw {mount.yaw_deg:g}, roll {mount.roll_deg:g} degrees" if mount.yaw_deg or mount.roll_deg else ""
    unstated = "" if "pitch_deg" in mount.model_fields_set else ", as no pitch is stated"
    return f"left camera: {place}, looks {abs(pitch):g} degrees {'down' if pitch >= 0 else 'up'}{turned}{unstated}"
