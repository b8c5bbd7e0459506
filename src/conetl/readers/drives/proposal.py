"""A folder with stereo video or images, a trajectory and a calibration -> settings that make it a drive, for `conetl init`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import validated
from conetl.geometry import rig as rigs
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.video import VIDEO_SUFFIXES, video_facts
from conetl.readers.drives import find_format, zed_recording
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, Mount
from conetl.readers.drives.formats import image_files, names_in
from conetl.readers.drives.pairs import first_size
from conetl.readers.drives.template import RIG, Missing
from conetl.readers.drives.video_timing import stated_start
from conetl.readers.rigs import RIG_SUFFIXES, RIG_YAML, FoundRigs, find_rigs, read_given_rig
from conetl.readers.trajectories import find_trajectories, read_trajectory, trajectory_format
from conetl.readers.trajectories.recorded import RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile

_TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})
#: Assumptions about a table that does not state its time scale or heights.
_TAKEN = {
    "time": "times taken as UTC; if they are local or GPS times, set trajectory.time, like Europe/Berlin or gps",
    "heights": "heights taken as ellipsoidal; if they are not, set trajectory.heights, like EPSG:7837",
}
#: Keys that a trajectory may need: the error of its reader says how to state them in drive.yaml.
_UNSTATED = ("columns", "date", "time", "crs", "heights")
#: What those errors advise, which a template has its own place for.
_REMEDY = re.compile(r"(?:[:;.?]) (?:put|name them) (?=.*drive\.yaml)", re.IGNORECASE)
#: What people call the file or folder of a camera.
_SIDE_NAMES: Mapping[Side, tuple[str, ...]] = {"left": ("left", "links"), "right": ("right", "rechts")}
#: Keys that name a file or folder of the drive.
FILE_KEYS = (
    "images.left",
    "images.right",
    "images.timestamps",
    "images.right_timestamps",
    "trajectory.file",
    "control_points.file",
)


class Proposal(NamedTuple):
    """What was found in a folder, what is missing, and the settings so far."""

    found: list[str]
    missing: list[Missing]
    settings: dict[str, Any]
    """Content of drive.yaml."""
    rig: Rig | None
    """To be written as rig.yaml; None where there is one."""
    recorded: RecordedTrajectory | None
    """The trajectory, where it can be read."""


def propose(root: Path, settings: Mapping[str, Any], rig_file: Path | None = None) -> Proposal:
    """The settings of a drive folder: those that are given, and what the folder shows.

    settings: valid ones of `DriveYaml`; rig_file: the calibration to use. Raises InputError where there is nothing to make a
    drive of, or a setting does not fit.
    """
    copied = {name: dict(value) if isinstance(value, Mapping) else value for name, value in settings.items()}
    proposal = Proposal([], [], copied, None, None)
    size = _add_images(root, rig_file, proposal)
    recorded = _add_trajectory(root, proposal)
    rig = _add_rig(root, rig_file, proposal, size)
    return proposal._replace(rig=rig, recorded=recorded)


def value_at(settings: Mapping[str, Any], key: str) -> Any:
    """The value of a key like `images.left`; None where there is none."""
    section, _, name = key.partition(".")
    values = settings.get(section)
    return values.get(name) if isinstance(values, Mapping) else None


def still_valid(settings: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of an earlier drive.yaml without those that new ones make invalid."""

    def changes(*keys: str) -> bool:
        known = [(value_at(settings, key), value_at(given, key)) for key in keys]
        return any(new is not None and old not in (None, new) for old, new in known)

    kept = {section: dict(value) if isinstance(value, Mapping) else value for section, value in settings.items()}
    images, has_start = kept.get("images", {}), value_at(given, "images.start") is not None
    becomes_one = value_at(given, "images.layout") is not None and "right" in images
    if becomes_one or changes("images.left", "images.right", "images.layout"):
        kept["images"] = images = {key: value for key, value in images.items() if key in ("every", "from_s", "to_s")}
        kept.pop("clock", None)
    if changes("trajectory.file"):
        # The start was found with the other log, or noted by a clock like its own.
        if "clock" in kept:
            images.pop("start", None)
        kept = {section: value for section, value in kept.items() if section not in ("trajectory", "sigmas", "clock")}
    if has_start:
        kept.pop("clock", None)
        for key in ("timestamps", "right_timestamps"):
            images.pop(key, None)
    return kept


def _add_images(root: Path, rig_file: Path | None, proposal: Proposal) -> tuple[int, int] | None:
    """Size of the images of one camera, where it is known."""
    videos = [root / name for name in names_in(root, VIDEO_SUFFIXES)]
    folders = [path for path in sorted(root.iterdir()) if path.is_dir() and image_files(path)]
    images = proposal.settings.setdefault("images", {})
    _check_images(root, proposal.settings)
    sources = videos or folders
    if not sources:
        if (error := zed_recording(root)) is not None:
            raise error
        inside = [child for child in sorted(root.iterdir()) if find_format(child)]
        hint = f"; {inside[0].name} is a drive already: conetl ingest {inside[0]}" if inside else ""
        raise InputError(
            f"{root}: there are no videos ({', '.join(sorted(VIDEO_SUFFIXES))}) and no folders of images here{hint}"
        )
    alike: dict[str, list[str]] = {}
    for source in videos:
        facts = video_facts(source)
        rate = facts.frames / facts.duration_s if facts.duration_s else 0.0
        size, lasts = f"{facts.width_px} x {facts.height_px}", f"{rate:.2f} Hz, {facts.duration_s:.0f} s"
        alike.setdefault(f"{size}, {facts.frames:,} frames, {lasts}", []).append(source.name)
    proposal.found.extend(f"video {' and '.join(names)}: {text}" for text, names in alike.items())
    if not videos:
        proposal.found.extend(f"images in {folder.name}/: {len(image_files(folder)):,}" for folder in folders)
    if len(sources) == 1 or "layout" in images:
        images.setdefault("left", sources[0].name)
        if videos and "layout" not in images and (layout := _layout_of(root, rig_file)) is not None:
            images["layout"] = layout
            proposal.found.append(f"{images['left']}: layout {layout}, by the size of the calibration")
        if "layout" not in images:
            proposal.missing.append(Missing("images.layout"))
    else:
        _add_sides([source.name for source in sources], proposal)
    if "left" not in images or (len(sources) == 1 and "layout" not in images):
        return None
    if not videos:
        folder = root / images["left"]
        return first_size(image_files(folder)) if folder.is_dir() else None
    facts, layout = video_facts(root / images["left"]), images.get("layout", "")
    across, down = 2 if "left" in layout else 1, 2 if "top" in layout else 1
    return facts.width_px // across, facts.height_px // down


def _add_sides(names: Sequence[str], proposal: Proposal) -> None:
    """Which file or folder is of which camera: by their names; of two, the other one is known with the first."""
    images = proposal.settings["images"]
    for side in SIDES:
        candidates = _of_side(names, side)
        if side not in images and len(candidates) == 1:
            images[side] = candidates[0]
    unknown = [side for side in SIDES if side not in images]
    unused = [name for name in names if name not in images.values()]
    if len(names) == 2 and len(unknown) == len(unused) == 1:
        images[unknown[0]] = unused[0]
    else:
        for side in unknown[:1] if len(names) == 2 else unknown:
            proposal.missing.append(Missing(f"images.{side}", f"Found: {', '.join(names)}", names[0]))


def _layout_of(root: Path, rig_file: Path | None) -> str | None:
    """How both images lie in each frame of the only video, left or top first, if a calibration is for one half of the frame."""

    def fits(size: tuple[int, int]) -> bool:
        if rig_file is None:
            return bool(_rigs_in(root, size).fitting)
        camera = read_given_rig(rig_file, size)[0].left
        return (camera.width_px, camera.height_px) == size

    facts = video_facts(root / names_in(root, VIDEO_SUFFIXES)[0])
    width_px, height_px = facts.width_px, facts.height_px
    halves = {"left-right": (width_px // 2, height_px), "top-bottom": (width_px, height_px // 2)}
    fitting = [layout for layout, size in halves.items() if fits(size)]
    return fitting[0] if len(fitting) == 1 and not fits((width_px, height_px)) else None


def _of_side(names: Sequence[str], side: Side) -> list[str]:
    """The files or folders that are called left or right, else those with its letter alone, like GX010042_L.MP4."""
    stems = {name: Path(name).stem.lower() for name in names}
    return [name for name, stem in stems.items() if any(word in stem for word in _SIDE_NAMES[side])] or [
        name for name, stem in stems.items() if side[0] in re.split(r"[^a-z]+", stem)
    ]


def _check_images(root: Path, settings: Mapping[str, Any]) -> None:
    """Raise InputError for files that are not there, and for a start that cannot be read."""
    for key in FILE_KEYS:
        name = value_at(settings, key)
        if name is not None and not (root / name).exists():
            raise InputError(f"{key}: there is no file or folder {name} in {root}")
    stated_start(DriveYaml.model_validate(settings), root)


def _add_trajectory(root: Path, proposal: Proposal) -> RecordedTrajectory | None:
    settings = proposal.settings.setdefault("trajectory", {})
    candidates = find_trajectories(root) if "file" not in settings else []
    if len(candidates) == 1:
        settings["file"] = candidates[0].relative_to(root).as_posix()
    elif "file" not in settings:
        names = ", ".join(path.relative_to(root).as_posix() for path in candidates) or "none was recognised"
        if not candidates and (tables := names_in(root, _TABLE_SUFFIXES)):
            names += f"; there is {', '.join(tables)}"
        proposal.missing.append(Missing("trajectory.file", f"Found: {names}"))
        return None
    path = root / settings["file"]
    try:
        recorded = read_trajectory(path, validated(settings, TrajectoryFile, "trajectory"))
    except InputError as error:
        unstated = next((key for key in _UNSTATED if key not in settings and f"{{{key}: " in str(error)), None)
        if unstated is None and _may_be_columns(path, settings, str(error)):
            unstated = "columns"
        if unstated is None:
            raise
        proposal.missing.append(Missing(f"trajectory.{unstated}", _REMEDY.split(str(error))[0]))
        return None
    kind = trajectory_format(path) or "table"
    proposal.found.append(_described(recorded, kind))
    proposal.found.extend(recorded.notes)
    if kind == "table":
        proposal.found.extend(f"{recorded.name}: {text}" for key, text in _TAKEN.items() if key not in settings)
    stated_m = value_at(proposal.settings, "sigmas.horizontal_m")
    if stated_m is None and not np.isfinite(recorded.sigma[:, :2]).any():
        proposal.missing.append(Missing("sigmas.horizontal_m"))
    return recorded


def _may_be_columns(path: Path, settings: Mapping[str, Any], error: str) -> bool:
    """Whether other columns of a table may be the remedy of an error of its records, and not another setting that it names."""
    named = any(str(settings[key]) in error for key in _UNSTATED if key in settings)
    is_table = path.is_file() and trajectory_format(path) in {None, "table"}
    return "columns" not in settings and ": no usable pose: line " in error and is_table and not named


def check_start(root: Path, settings: Mapping[str, Any], recorded: RecordedTrajectory) -> None:
    """Raise InputError where no part of the video, by its stated start, is within the time of the trajectory."""
    images, path = settings["images"], root / settings["images"]["left"]
    start_ns = stated_start(DriveYaml.model_validate(settings), root)
    if start_ns is None or "clock" in settings or path.is_dir():
        return
    times_ns = recorded.times_ns
    if start_ns <= times_ns[-1] and start_ns + 1e9 * video_facts(path).duration_s >= times_ns[0]:
        return
    first, last = (f"{utc_from_ns(int(t)):%Y-%m-%d %H:%M:%S}" for t in times_ns[[0, -1]])
    raise InputError(
        f"images.start {images['start']}: {settings['trajectory']['file']} covers {first} to {last} UTC, but the video is of "
        "another time; state images.start with its offset from UTC, like 2026-03-02 11:00:00.250+01:00, or the time zone of the "
        "log in trajectory.time"
    )


def stated_time(time_ns: int) -> str:
    """A time as drive.yaml states it."""
    return f"{utc_from_ns(time_ns):%Y-%m-%d %H:%M:%S}.{time_ns % 10**9:09d}Z"


def suggested(
    root: Path, settings: Mapping[str, Any], recorded: RecordedTrajectory, key: str
) -> tuple[str, str] | None:
    """A value for `images.start` or `images.timestamps`, and the reason: the trajectory has a record per left image."""
    left, log = root / settings["images"]["left"], settings["trajectory"]["file"]
    times_ns, count = recorded.times_ns, len(recorded.times_ns)
    if left.is_dir():
        if key != "images.timestamps" or count != len(image_files(left)) or recorded.bad:
            return None
        return log, f"{log} has one record per image; if each states the time of its image, name this file"
    facts, span_s = video_facts(left), float(times_ns[-1] - times_ns[0]) * 1e-9
    if (
        key != "images.start"
        or count != facts.frames
        or abs(span_s - facts.duration_s) > 2 * span_s / max(count - 1, 1)
    ):
        return None
    start = stated_time(int(times_ns[0]))
    return start, f"{log} has one record per frame; if the first is of the first frame, that was at {start}"


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


def _add_rig(root: Path, rig_file: Path | None, proposal: Proposal, size: tuple[int, int] | None) -> Rig | None:
    """The rig that has to be written; None where it is there, or is not known yet."""
    if rig_file is not None:
        path = rig_file
        rig, kind = read_given_rig(path, size)
    else:
        found, of_other_size, unread = _rigs_in(root, size)
        proposal.found.extend(of_other_size)
        if unread and not found and size is None and proposal.missing:
            return None  # one may fit once the size of the images is known
        if not found:
            proposal.found.extend(unread)
        replaces = (root / RIG_YAML).is_file() and RIG_YAML not in (path.name for path, _, _ in found)
        if len(found) != 1 or replaces:  # a file that somebody made is not replaced without being asked
            names = ", ".join(path.name for path, _, _ in found) or "none that fits"
            cause = f"Found: {names}."
            if not found:
                cause += " 'conetl calibrate' makes one from images of a board."
            proposal.missing.append(Missing(RIG, cause + f" It replaces {RIG_YAML}." * replaces))
            return None
        path, rig, kind = found[0]
    image_size = f"{rig.left.width_px} x {rig.left.height_px}"
    proposal.found.append(f"calibration {path.name} ({kind}): {image_size}, baseline {rig.baseline_m:.3f} m")
    if "mount" in proposal.settings:
        proposal.found.append(_mounted(Mount.model_validate(proposal.settings["mount"])))
    elif rigs.body_is_left_camera(rig):
        proposal.missing.append(Missing("mount"))
    return None if path == root / RIG_YAML else rig


def _rigs_in(root: Path, size: tuple[int, int] | None) -> FoundRigs:
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
