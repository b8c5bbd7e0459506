"""A folder with stereo video or images, a trajectory and a calibration -> settings that make it a drive, for `conetl init`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import input_errors, library_errors, shown, validated
from conetl.geometry import rig as rigs
from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Rig, Side
from conetl.perception.video import LAYOUTS, VIDEO_SUFFIXES, video_facts
from conetl.readers.drives import find_format, zed_recording
from conetl.readers.drives.drive_yaml import DRIVE_YAML
from conetl.readers.drives.formats import image_files, names_in
from conetl.readers.drives.pairs import first_size
from conetl.readers.rigs import CAM_TO_CAM, RIG_SUFFIXES, RIG_YAML, FoundRigs, find_rigs, read_given_rig
from conetl.readers.trajectories import find_trajectories, read_trajectory, trajectory_format, unknown_heights
from conetl.readers.trajectories.earth import UNSTATED_HEIGHT_SIGMA_M
from conetl.readers.trajectories.recorded import RecordedTrajectory
from conetl.readers.trajectories.settings import TrajectoryFile
from conetl.readers.trajectories.times import parse_timestamp

_TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})
#: Assumptions about a table that does not state its time scale or heights.
_TAKEN = {
    "time": "times taken as UTC; if they are local or GPS times, state --time, like Europe/Berlin or gps",
    "heights": "heights taken as ellipsoidal; if they are not, state --heights, like EPSG:7837",
}
#: No number of metres or degrees is written like 07 or -0, but what is behind a decimal comma is.
_LEADING_ZERO = re.compile(r"-0|-?0\d+")
#: Keys that a trajectory may need: the error of its reader says how to state them in drive.yaml.
_UNSTATED = {
    "columns": "Which columns contain what (name or number), like time=Zeit,lat=B,lon=L,height=H,roll=R,pitch=P,heading=K?",
    "date": "On which day was it recorded, like 2026-03-02?",
    "time": "In which time system are its times: utc, gps, or a time zone like Europe/Berlin?",
    "crs": "In which coordinate reference system are its positions, like EPSG:25832?",
    "heights": "In which system are its heights, like EPSG:5773?",
}
#: What those errors advise; `conetl init` asks instead.
_REMEDY = re.compile(r"(?:[:;.?]) (?:put|name them) (?=.*drive\.yaml)", re.IGNORECASE)
#: What people call the file or folder of a camera.
_SIDE_NAMES: Mapping[Side, tuple[str, ...]] = {"left": ("left", "links"), "right": ("right", "rechts")}
#: Answer of heights that may be above the sea or the ellipsoid.
_UNKNOWN = "unknown"
#: Section and key of drive.yaml of what an option of `conetl init` answers; those of the mount are one answer.
_KEYS = {
    "left": ("images", "left"), "right": ("images", "right"), "layout": ("images", "layout"), "start": ("images", "start"),
    "right-offset": ("images", "right_offset_s"), "timestamps": ("images", "timestamps"),
    "right-timestamps": ("images", "right_timestamps"), "trajectory": ("trajectory", "file"), "date": ("trajectory", "date"),
    "time": ("trajectory", "time"), "crs": ("trajectory", "crs"), "heights": ("trajectory", "heights"),
    "sigma": ("sigmas", "horizontal_m"), "columns": ("trajectory", "columns"),
}  # fmt: skip
_MOUNT = ("forward_m", "left_m", "up_m", "pitch_deg", "yaw_deg", "roll_deg")


class Question(NamedTuple):
    """A setting that cannot be found in the folder."""

    key: str
    """Name of the option of `conetl init` that answers it."""
    text: str
    default: str | None = None
    cause: str | None = None
    """The reason for the question."""


class Proposal(NamedTuple):
    """What was found in a folder, what is missing, and the settings so far."""

    found: list[str]
    questions: list[Question]
    settings: dict[str, Any]
    """Content of drive.yaml."""
    rig: Rig | None
    """To be written as rig.yaml; None where there is one."""


def propose(root: Path, answers: Mapping[str, str], *, asks: bool = False) -> Proposal:
    """The settings of a drive folder. answers: by `Question.key`; questions that they answer are left out.

    asks: also questions that nobody has to answer.

    Raises InputError where there is nothing to make a drive of, or an answer does not fit.
    """
    proposal = Proposal([], [], {}, None)
    size = _add_images(root, answers, proposal)
    _add_trajectory(root, answers, proposal, asks=asks)
    rig = _add_rig(root, answers, proposal, size)
    return proposal._replace(rig=rig)


def still_valid(settings: Mapping[str, Any], given: Mapping[str, str]) -> dict[str, Any]:
    """The settings of an earlier drive.yaml without those that new answers replace or make invalid."""

    def changes(*options: str) -> bool:
        known = ((given[o], settings.get(_KEYS[o][0], {}).get(_KEYS[o][1])) for o in options if o in given)
        return any(value is not None and str(value) != answer for answer, value in known)

    kept = {section: dict(value) if isinstance(value, Mapping) else value for section, value in settings.items()}
    images = kept.get("images", {})
    exchanged = (given.get("left"), given.get("right")) == (images.get("right"), images.get("left"))
    if exchanged and {"start", "right_offset_s"} <= images.keys():  # the other file is the left one now
        start_ns = parse_timestamp(images["start"]) + round(1e9 * images["right_offset_s"])
        images |= {"start": f"{np.datetime64(start_ns, 'ns')}Z", "right_offset_s": 0.0 - images["right_offset_s"]}
    elif changes("left", "right", "layout") or ("layout" in given and "right" in kept.get("images", {})):
        kept["images"] = {key: v for key, v in kept.get("images", {}).items() if key in ("every", "from_s", "to_s")}
        kept.pop("clock", None)
    if changes("trajectory"):
        for section in ("trajectory", "sigmas"):
            kept.pop(section, None)
        # The start was found with the other log, or noted by a clock like its own.
        if kept.pop("clock", None) is not None:
            kept.get("images", {}).pop("start", None)
    if "start" in given:
        kept.pop("clock", None)
        for key in ("timestamps", "right_timestamps"):
            kept.get("images", {}).pop(key, None)
    if "mount" in given:
        kept.pop("mount", None)
    for section, key in (_KEYS[option] for option in given if option in _KEYS):
        kept.get(section, {}).pop(key, None)
    return {section: value for section, value in kept.items() if value != {}}


def answers_in(settings: Mapping[str, Any]) -> dict[str, str]:
    """The answers that are in settings of drive.yaml, by `Question.key`."""
    found = {option: settings.get(section, {}).get(key) for option, (section, key) in _KEYS.items()}
    if (mount := settings.get("mount")) is not None:
        found["mount"] = ",".join(str(mount.get(key, 0.0)) for key in _MOUNT)
    return {
        option: json.dumps(value) if isinstance(value, dict) else str(value)
        for option, value in found.items()
        if value is not None
    }


def _add_images(root: Path, answers: Mapping[str, str], proposal: Proposal) -> tuple[int, int] | None:
    """Size of the images of one camera, where it is known."""
    videos = [root / name for name in names_in(root, VIDEO_SUFFIXES)]
    folders = [path for path in sorted(root.iterdir()) if path.is_dir() and image_files(path)]
    images = _stated_images(root, answers)
    proposal.settings["images"] = images
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
        if videos and "layout" not in images and (layout := _layout_of(root, answers)) is not None:
            images["layout"] = layout
            proposal.found.append(f"{images['left']}: layout {layout}, by the size of the calibration (else: --layout)")
        if "layout" not in images:
            text = "Where are left and right in each frame: left-right, right-left, top-bottom or bottom-top?"
            proposal.questions.append(Question("layout", text, "left-right"))
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
            proposal.questions.append(Question(side, f"Which is the {side} camera ({', '.join(names)})?"))


def _layout_of(root: Path, answers: Mapping[str, str]) -> str | None:
    """How both images lie in each frame of the only video, left or top first, if a calibration is for one half of the frame."""

    def fits(size: tuple[int, int]) -> bool:
        if "rig" not in answers:
            return bool(_rigs_in(root, size).fitting)
        camera = read_given_rig(root / answers["rig"], size)[0].left
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


def _stated_images(root: Path, answers: Mapping[str, str]) -> dict[str, Any]:
    """The settings of images that the answers state. Raises InputError."""
    options = ("left", "right", "layout", "start", "timestamps", "right-timestamps")
    images: dict[str, Any] = {_KEYS[option][1]: answers[option] for option in options if option in answers}
    if "right-offset" in answers:
        images["right_offset_s"] = _numbers("right-offset", answers["right-offset"], 1, 1)[0]
    if images.get("layout", LAYOUTS[0]) not in LAYOUTS:
        raise InputError(f"--layout {shown(images['layout'])}: expected one of {', '.join(LAYOUTS)}")
    if "start" in images:
        with input_errors("--start"):
            parse_timestamp(images["start"])
    for option in ("timestamps", "right-timestamps", *SIDES):
        if option in answers and not (root / answers[option]).exists():
            raise InputError(f"--{option} {answers[option]}: there is no such file or folder in {root}")
    return images


def _add_trajectory(root: Path, answers: Mapping[str, str], proposal: Proposal, *, asks: bool) -> None:
    settings: dict[str, Any] = {}
    candidates = find_trajectories(root)
    if "trajectory" in answers:
        settings["file"] = answers["trajectory"]
    elif len(candidates) == 1:
        settings["file"] = candidates[0].relative_to(root).as_posix()
    else:
        names = ", ".join(path.relative_to(root).as_posix() for path in candidates) or "none was recognised"
        if not candidates and (tables := names_in(root, _TABLE_SUFFIXES)):
            names += f"; there is {', '.join(tables)}"
        proposal.questions.append(Question("trajectory", f"Which file is the GNSS/INS trajectory ({names})?"))
        return
    given = {key: answers[key] for key in ("date", "time", "crs", "heights") if key in answers}
    settings |= {key: value for key, value in given.items() if (key, value) != ("heights", _UNKNOWN)}
    if "columns" in answers:
        settings["columns"] = _columns(answers["columns"])
    proposal.settings["trajectory"] = settings
    path = root / settings["file"]
    try:
        recorded = _recorded(path, json.dumps(settings))
    except InputError as error:
        asked = next((key for key in _UNSTATED if key not in answers and f"{{{key}: " in str(error)), None)
        if asked is None and _may_be_columns(path, answers, str(error)):
            asked = "columns"
        if asked is None:
            raise
        cause = _REMEDY.split(str(error))[0]
        proposal.questions.append(Question(asked, _UNSTATED[asked], cause=cause))
        return
    kind = trajectory_format(path) or "table"
    proposal.found.append(_described(recorded, kind))
    if kind == "table":
        proposal.found.extend(f"{recorded.name}: {text}" for key, text in _TAKEN.items() if key not in settings)
    if asks and "heights" not in answers and unknown_heights(path, TrajectoryFile.model_validate(settings)):
        text = (
            f"Heights of {recorded.name}: EPSG:5773 if above sea level (EGM96), ellipsoidal, or unknown (sigma "
            f"{UNSTATED_HEIGHT_SIGMA_M:g} m)?"
        )
        proposal.questions.append(Question("heights", text, default=_UNKNOWN))
    if "sigma" in answers:
        proposal.settings["sigmas"] = {"horizontal_m": _numbers("sigma", answers["sigma"], 1, 1)[0]}
    elif not np.isfinite(recorded.sigma[:, :2]).any():
        text = "How accurate are its positions, horizontally, in metres (RTK 0.02, corrected 0.5, single 3)?"
        proposal.questions.append(Question("sigma", text))


def _may_be_columns(path: Path, answers: Mapping[str, str], error: str) -> bool:
    """Whether other columns of a table may be the remedy of an error of its records, and not another answer that it names."""
    named = any(answers[key] in error for key in _UNSTATED if key in answers)
    is_table = path.is_file() and trajectory_format(path) in {None, "table"}
    return "columns" not in answers and ": no usable pose: line " in error and is_table and not named


def outside_log(root: Path, settings: Mapping[str, Any]) -> str | None:
    """The error of a stated start with which no part of the video is within the time of the trajectory; None if it is right."""
    images, log = settings["images"], settings["trajectory"]
    path = root / images["left"]
    if "start" not in images or "clock" in settings or path.is_dir():
        return None
    times_ns = _recorded(root / log["file"], json.dumps(log)).times_ns
    start_ns = parse_timestamp(images["start"])
    if start_ns <= times_ns[-1] and start_ns + 1e9 * video_facts(path).duration_s >= times_ns[0]:
        return None
    first, last = (f"{utc_from_ns(int(t)):%Y-%m-%d %H:%M:%S}" for t in times_ns[[0, -1]])
    return (
        f"--start {images['start']}: {log['file']} covers {first} to {last} UTC, but the video is of another time; state --start "
        "with its offset from UTC, like 2026-03-02 11:00:00.250+01:00, or the time zone of the log with --time"
    )


def stated_time(time_ns: int) -> str:
    """A time as drive.yaml states it."""
    return f"{utc_from_ns(time_ns):%Y-%m-%d %H:%M:%S}.{time_ns % 10**9:09d}Z"


def suggested(root: Path, settings: Mapping[str, Any], key: str) -> tuple[str, str] | None:
    """An answer to the question for `start` or `timestamps`, and the reason: the trajectory has a record per left image."""
    images, log = settings["images"], settings["trajectory"]
    left, recorded = root / images["left"], _recorded(root / log["file"], json.dumps(log))
    times_ns = recorded.times_ns
    if left.is_dir():
        if key != "timestamps" or len(times_ns) != len(image_files(left)) or recorded.bad:
            return None
        reason = f"{log['file']} has one record per image; if each states the time of its image, name this file"
        return log["file"], reason
    facts, span_s = video_facts(left), float(times_ns[-1] - times_ns[0]) * 1e-9
    count = len(times_ns)
    if key != "start" or count != facts.frames or abs(span_s - facts.duration_s) > 2 * span_s / max(count - 1, 1):
        return None
    start = stated_time(int(times_ns[0]))
    return start, f"{log['file']} has one record per frame; if the first is of the first frame, that was at {start}"


def _columns(text: str) -> dict[str, str | int]:
    """Column by our name for it, of `time=Zeit,lat=2`, or of JSON. Raises InputError."""
    if text.startswith("{"):
        with library_errors(f"--columns {shown(text)}: this is not JSON", ValueError):
            return dict(json.loads(text))
    words = [word.partition("=") for word in text.split(",")]
    if not all(name.strip() and column.strip() for name, _, column in words):
        raise InputError(f"--columns {shown(text)}: expected names as in time=Zeit,lat=B,lon=L,height=H")
    values = {name.strip(): column.strip() for name, _, column in words}
    return {name: int(column) if column.isdecimal() else column for name, column in values.items()}


@lru_cache(maxsize=1)
def _recorded(path: Path, settings: str) -> RecordedTrajectory:
    """The trajectory, read once for all answers. settings: of `TrajectoryFile`, as JSON. Raises InputError."""
    return read_trajectory(path, validated(json.loads(settings), TrajectoryFile, "options of the trajectory"))


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


def _add_rig(root: Path, answers: Mapping[str, str], proposal: Proposal, size: tuple[int, int] | None) -> Rig | None:
    """The rig that has to be written; None where it is there, or is not known yet."""
    if "rig" in answers:
        path = root / answers["rig"]
        rig, kind = read_given_rig(path, size)
    else:
        found, of_other_size, unread = _rigs_in(root, size)
        proposal.found.extend(of_other_size)
        if unread and not found and size is None and proposal.questions:
            return None  # one may fit once the size of the images is known
        if not found:
            proposal.found.extend(unread)
        replaces = (root / RIG_YAML).is_file() and RIG_YAML not in (path.name for path, _, _ in found)
        if len(found) != 1 or replaces:  # a file that somebody made is not replaced without being asked
            names = ", ".join(path.name for path, _, _ in found) or "none was found that fits"
            text = f"Which file is the calibration of the cameras ({names})?"
            if not found:
                text += " 'conetl calibrate' makes one from images of a board."
            proposal.questions.append(Question("rig", text + f" It replaces {RIG_YAML}." * replaces))
            return None
        path, rig, kind = found[0]
    image_size = f"{rig.left.width_px} x {rig.left.height_px}"
    proposal.found.append(f"calibration {path.name} ({kind}): {image_size}, baseline {rig.baseline_m:.3f} m")
    if "mount" in answers:
        values = _numbers("mount", answers["mount"], 3, 6)
        proposal.settings["mount"] = dict(zip(_MOUNT, values, strict=False))
        proposal.found.append(_mounted(values))
    elif rigs.body_is_left_camera(rig):
        text = (
            "Left camera from the antenna or IMU of the log: metres forward, left (right is negative), up, then degrees of "
            "downward tilt, like 1.2,0.3,-0.2,3"
        )
        proposal.questions.append(Question("mount", text))
    return None if path == root / RIG_YAML else rig


def _rigs_in(root: Path, size: tuple[int, int] | None) -> FoundRigs:
    names = names_in(root, RIG_SUFFIXES) + [CAM_TO_CAM] * (root / CAM_TO_CAM).is_file()
    return find_rigs([root / name for name in names if name != DRIVE_YAML], size)


def _mounted(values: Sequence[float]) -> str:
    """A mount in words: a sign the wrong way round is seen there."""
    forward, left, up, pitch, yaw, roll = (*values, 0.0, 0.0, 0.0)[:6]
    along, aside = "in front of" if forward >= 0 else "behind", "left of" if left >= 0 else "right of"
    over = "above" if up >= 0 else "below"
    place = f"{abs(forward):g} m {along}, {abs(left):g} m {aside} and {abs(up):g} m {over} the antenna or IMU"
    turned = f", yaw {yaw:g}, roll {roll:g} degrees" if yaw or roll else ""
    unstated = ", as no pitch is stated" if len(values) == 3 else ""
    return f"left camera: {place}, looks {abs(pitch):g} degrees {'down' if pitch >= 0 else 'up'}{turned}{unstated}"


def _numbers(key: str, text: str, least: int, most: int) -> list[float]:
    """Numbers separated by commas, or by semicolons with decimal points or commas. Raises InputError."""
    words = text.replace(",", ".").split(";") if ";" in text else text.split(",")
    if most > 1 and (odd := next((word for word in words if _LEADING_ZERO.fullmatch(word.strip())), None)):
        raise InputError(
            f"--{key} {shown(text)}: {odd.strip()} looks like the end of a number with a decimal comma; write decimal points, or "
            "semicolons between the numbers"
        )
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if not least <= len(values) <= most or not np.isfinite(values).all():
        wanted = f"{least} to {most} numbers, separated by commas" if most > least else "a number"
        raise InputError(f"--{key} '{text[:60]}': expected {wanted}")
    return values
