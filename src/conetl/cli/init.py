"""`conetl init`: make a drive of a folder with stereo video or images, a trajectory and a calibration."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import typer

from conetl.cli.console import JsonOption, answer, complain, say, spinner
from conetl.files.atomic import atomic_files
from conetl.files.documents import validated
from conetl.model.base import utc_from_ns
from conetl.model.errors import EXIT_NEEDS_ATTENTION, ConetlError, DriveFolderError, InputError
from conetl.model.rig import SIDES, Rig
from conetl.perception.stereo_check import TRIGGER, check_stereo
from conetl.perception.video import video_facts
from conetl.readers.drives import find_format, plain
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, read_drive_yaml
from conetl.readers.drives.proposal import Proposal, Question, answers_in, outside_log, propose, still_valid
from conetl.readers.drives.video import NAME, Preview, preview
from conetl.readers.drives.video_timing import Timing, UnknownTimeError
from conetl.readers.rigs import RIG_YAML, write_rig_yaml
from conetl.readers.svo2 import copy_video, read_svo2, svo2_of

_TIME_QUESTIONS = {
    "timestamps": "File with the time of every left image, one per line (UTC, or nanoseconds since 1970)",
    "start": "Time of the first left frame, UTC or with its offset, like 2026-03-02 11:00:00.250+01:00",
    "right-offset": "Seconds by which the right file begins after the left one (0: both begin with one trigger)",
}
#: Answers with which the questions that come after these can be found, too.
_STAND_INS = {"layout": "left-right", "sigma": "1", "mount": "0,0,0", "right-offset": "0"}
_FILE_OPTIONS = frozenset({"left", "right", "timestamps", "right-timestamps", "trajectory", "rig"})
_COMMENTS = {
    "images": "the videos or folders of images",
    "trajectory": "the GNSS/INS log",
    "mount": "left camera as seen from antenna or IMU; if its angles may be off by 1 degree: sigmas: {pitch_deg: 1}",
    "sigmas": "of the trajectory, which states none",
    "clock": "of the images against the trajectory; found from turns and changes of speed",
}


def init(
    folder: Annotated[Path, typer.Argument(help="Folder with videos or images, a trajectory and a calibration.")],
    left: Annotated[str | None, typer.Option(help="File or folder of the left camera.")] = None,
    right: Annotated[str | None, typer.Option(help="File or folder of the right camera.")] = None,
    layout: Annotated[
        str | None,
        typer.Option(help="Where both images are in one file: left-right, right-left, top-bottom, bottom-top."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Time of the first left frame, UTC or with its offset; else found from the images."),
    ] = None,
    right_offset: Annotated[
        str | None,
        typer.Option(
            help="Seconds to add to the times of the right file to get those of the left one; else found from the images."
        ),
    ] = None,
    timestamps: Annotated[
        str | None,
        typer.Option(help="File with the time of every left image, one per line, if their names are not times."),
    ] = None,
    right_timestamps: Annotated[
        str | None, typer.Option(help="The same for the right images, if their times differ.")
    ] = None,
    every: Annotated[int | None, typer.Option(min=1, help="Use every n-th frame pair.")] = None,
    from_s: Annotated[
        float | None, typer.Option("--from", min=0.0, help="Use the recording from this second of the left file on.")
    ] = None,
    to_s: Annotated[
        float | None, typer.Option("--to", min=0.0, help="Use the recording up to this second of the left file.")
    ] = None,
    trajectory: Annotated[str | None, typer.Option(help="The GNSS/INS log.")] = None,
    date: Annotated[str | None, typer.Option(help="Day of the recording, for logs without a date.")] = None,
    log_time: Annotated[
        str | None,
        typer.Option("--time", help="Times of the log, if they are not UTC: gps, or a zone like Europe/Berlin."),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option(help="Columns of a table, by name or number, like time=Zeit,lat=B,lon=L."),
    ] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the log's positions, like EPSG:25832.")] = None,
    heights: Annotated[str | None, typer.Option(help="ellipsoidal, or a height system like EPSG:5773.")] = None,
    sigma: Annotated[str | None, typer.Option(help="Horizontal sigma of the log in metres, if it states none.")] = None,
    rig: Annotated[
        str | None, typer.Option(help="Calibration of the cameras, in any format of `conetl rig convert`.")
    ] = None,
    mount: Annotated[
        str | None,
        typer.Option(
            help="Left camera from the antenna or IMU: metres forward, left, up, then degrees of pitch, yaw, roll, "
            "like 1.2,0.3,-0.2,3."
        ),
    ] = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Ask nothing: take what is clear, fail where something is missing.")
    ] = False,
    force: Annotated[
        bool,
        typer.Option(help="Write an existing drive.yaml again; its settings are kept, unless an option changes them."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Look at a folder, ask for what is missing, and write drive.yaml.

    In a terminal every open question is asked; elsewhere, and with --yes, the message names the options that answer them.
    """
    root = folder.resolve()
    if not root.is_dir():
        raise DriveFolderError(f"{folder}: there is no such folder")
    kind = find_format(root)
    # Folders called left and right may be a plain drive, or images with a log of any format.
    lacks_poses = kind is plain and not (root / plain.TRAJECTORY).is_file()
    if kind is not None and kind.NAME != NAME and not lacks_poses:
        _finish(folder, f"{folder} is a drive already ({kind.NAME}); nothing has to be written.", {}, as_json)
        return
    if (root / DRIVE_YAML).exists() and not force:
        raise InputError(f"{root / DRIVE_YAML} exists: edit it, or rewrite it with --force")
    options = {
        "left": left, "right": right, "layout": layout, "start": start, "right-offset": right_offset, "trajectory": trajectory,
        "date": date, "time": log_time, "crs": crs, "heights": heights, "sigma": sigma, "rig": rig, "mount": mount,
        "columns": columns, "timestamps": timestamps, "right-timestamps": right_timestamps,
    }  # fmt: skip
    given = {key: _of_folder(root, key, value) for key, value in options.items() if value is not None}
    part = {key: value for key, value in (("every", every), ("from_s", from_s), ("to_s", to_s)) if value is not None}
    if from_s is not None and to_s is not None and to_s <= from_s:
        raise InputError(f"--to {to_s:g} is not after --from {from_s:g}")
    kept = still_valid(_earlier(root), given)
    for key in part:
        kept.get("images", {}).pop(key, None)
    if kept and not as_json:
        say(f"  kept from {DRIVE_YAML}: {_listed(kept)}; delete the file to start over")
    answers = _of_zed(root, as_json=as_json) | answers_in(kept) | given
    kept["images"] = kept.get("images", {}) | part
    asks = sys.stdin.isatty() and not yes and not as_json
    settings, found, new_rig = _settled(root, answers, kept, asks=asks, as_json=as_json)
    _add_timing(settings, found.timing)
    _write(root, settings, new_rig)
    text = f"{folder / DRIVE_YAML}: {_counted(found)}"
    start_ns, sigma_s = found.timing.start_ns, found.timing.clock.sigma_s
    if start_ns is not None and found.timing.right_offset_s and not answers.keys() & {"right-offset", "layout"}:
        text += f"\nThe images fit a right file that begins {found.timing.right_offset_s:g} s after the left one."
    if start_ns is not None and sigma_s and "start" not in answers:
        text += (
            f"\nBy its images the first left frame is of {_stated(start_ns)}, +-{1000 * sigma_s:.0f} ms. "
            "If its time was noted, state it: --start."
        )
    _finish(folder, text, settings, as_json)


def _of_folder(root: Path, key: str, value: str) -> str:
    """The answer of an option; a file that is named from the current folder, as seen from the drive folder."""
    if key not in _FILE_OPTIONS or (root / value).exists() or not Path(value).exists():
        return value
    path = Path(value).resolve()
    return str(path.relative_to(root) if path.is_relative_to(root) else path)


def _earlier(root: Path) -> dict[str, Any]:
    """What an earlier drive.yaml states."""
    try:
        return read_drive_yaml(root).model_dump(mode="json", exclude_unset=True)
    except DriveFolderError as error:
        complain(f"{error}\nThe file is rewritten without it.")
        return {}


def _listed(settings: Mapping[str, Any]) -> str:
    """Sections of settings with their keys."""
    return ", ".join(
        f"{section} ({', '.join(values)})" if isinstance(values, Mapping) else section
        for section, values in settings.items()
    )


def _counted(found: Preview) -> str:
    """How many frame pairs can be used, and why others cannot."""
    usable, total = len(found.drive.frame_pairs), found.drive.expected_frame_count
    if usable == total:
        return f"{usable:,} frame pairs, positions in EPSG:{found.drive.map_srid} with ellipsoidal heights."
    reasons: dict[str, list[str]] = {}
    for rejection in found.rejections:
        reasons.setdefault(str(rejection.reason).replace("_", " "), []).append(rejection.detail)
    lines = [f"  {reason}: {len(details):,}, the first: {details[0]}" for reason, details in reasons.items()]
    return "\n".join([f"{usable:,} of {total:,} frame pairs can be used.", *lines])


def _settled(
    root: Path, answers: dict[str, str], kept: Mapping[str, Any], *, asks: bool, as_json: bool
) -> tuple[dict[str, Any], Preview, Rig | None]:
    """Settings, the drive that they make, and the rig that has to be written. Nothing is written while something is missing.

    kept: settings that no answer replaces. A wrong answer is asked again. Raises InputError where an answer is missing and
    nobody can be asked.
    """
    asked, shown = None, set[str]()
    while True:
        try:
            proposal = propose(root, answers)
        except ConetlError as error:
            if asked is None:
                raise
            say(str(error))
            answers[asked.key] = _answer(asked)
            continue
        for line in () if as_json else proposal.found:
            if line not in shown:
                say(f"  {line}")
        shown.update(proposal.found)
        settings, questions = _with(kept, proposal), proposal.questions
        if not questions and (problem := outside_log(root, settings)) is not None:
            if not asks:
                raise InputError(problem)
            questions = [Question("start", _TIME_QUESTIONS["start"], cause=problem)]
        elif not questions:
            try:
                return settings, _previewed(root, settings, proposal.rig), proposal.rig
            except UnknownTimeError as error:
                questions = [Question(error.key, _TIME_QUESTIONS[error.key], cause=error.cause)]
            except ConetlError as error:
                _write(root, settings, proposal.rig)
                complain(
                    f"{root / DRIVE_YAML} is written, but the drive cannot be read yet:\n{error}\nEdit the file, or run this "
                    "command again with --force and the options that correct it."
                )
                raise typer.Exit(EXIT_NEEDS_ATTENTION) from error
        if not asks:
            raise InputError(_missing(root, answers, kept, questions))
        asked = questions[0]
        if asked.cause:
            say(asked.cause)
        answers[asked.key] = _answer(asked)


def _with(kept: Mapping[str, Any], proposal: Proposal) -> dict[str, Any]:
    """Settings of drive.yaml: those that were kept, and those of a proposal."""
    settings = dict(kept)
    for section, values in proposal.settings.items():
        settings[section] = settings.get(section, {}) | values
    return settings


def _previewed(root: Path, settings: Mapping[str, Any], rig: Rig | None) -> Preview:
    """The drive of settings that are not written yet. Raises ConetlError.

    On a smooth road a right file with as many frames as the left one is not shifted if its images fit so better than otherwise.
    """
    with spinner("finding when the images were taken"):
        try:
            return preview(root, validated(settings, DriveYaml, "answers"), rig)
        except UnknownTimeError as error:
            images = settings["images"]
            if error.key != "right-offset" or len({video_facts(root / images[side]).frames for side in SIDES}) > 1:
                raise
            together = {**settings, "images": {**images, "right_offset_s": 0.0}}
            found = preview(root, validated(together, DriveYaml, "answers"), rig)
            if any(check.value != 0 for check in check_stereo(found.drive)[1] if check.name == TRIGGER):
                raise
            return found


def _missing(root: Path, answers: Mapping[str, str], kept: Mapping[str, Any], questions: Sequence[Question]) -> str:
    """All options that a folder still needs, as far as they can be known without the answers. questions: the first of them."""
    texts: dict[str, str] = {}
    known = dict(answers)
    with suppress(ConetlError):  # of the stand-ins
        while questions:
            texts |= {q.key: f"{q.text} ({q.cause})" if q.cause else q.text for q in questions}
            keys = {question.key for question in questions}
            if not keys <= _STAND_INS.keys():
                break
            known |= {key: _STAND_INS[key] for key in keys}
            proposal = propose(root, known)
            questions, settings = proposal.questions, _with(kept, proposal)
            if "layout" in texts and any(question.key == "rig" for question in questions):
                break  # a calibration may fit another layout
            if not questions:
                try:
                    _previewed(root, settings, proposal.rig)
                except UnknownTimeError as error:
                    questions = [Question(error.key, _TIME_QUESTIONS[error.key], cause=error.cause)]
    lines = "\n".join(f"  --{key}: {text}" for key, text in texts.items())
    return f"{root}: something is missing; answer it with these options:\n{lines}"


def _of_zed(root: Path, *, as_json: bool) -> dict[str, str]:
    """What a recording of a ZED camera answers itself; its video is copied into an MP4 file beside it."""
    path = svo2_of(root)
    if path is None:
        return {}
    found, target = read_svo2(path), path.with_suffix(".mp4")
    if not target.exists():
        with spinner(f"copying the video of {path.name}"):
            copy_video(path, target)
    if not as_json:
        camera = "" if found.serial is None else f", its factory calibration is SN{found.serial}.conf"
        say(f"  ZED recording {path.name}: {found.frames:,} frames, copied to {target.name}{camera}")
    answers = {"left": target.name, "layout": "left-right"}
    return answers if found.start_ns is None else answers | {"start": _stated(found.start_ns)}


def _answer(question: Question) -> str:
    return str(typer.prompt(question.text, default=question.default))


def _add_timing(settings: dict[str, Any], timing: Timing) -> None:
    """What the images showed, so that it is not searched again."""
    images = settings["images"]
    if timing.start_ns is not None:
        images["start"] = _stated(timing.start_ns)
        if "layout" not in images:
            images["right_offset_s"] = round(timing.right_offset_s, 6)
    if timing.clock.sigma_s:
        settings["clock"] = {"offset_s": 0.0, "sigma_s": round(timing.clock.sigma_s, 4)}


def _stated(time_ns: int) -> str:
    return f"{utc_from_ns(time_ns):%Y-%m-%d %H:%M:%S}.{time_ns % 10**9:09d}Z"


def _write(root: Path, settings: Mapping[str, Any], rig: Rig | None) -> None:
    """drive.yaml with a comment per section, and rig.yaml where there is a rig: both or neither."""
    text = "# How conetl reads this drive, written by 'conetl init'; all keys: docs/reference/drives.md\n"
    for section, values in settings.items():
        if not isinstance(values, Mapping):
            text += f"\n{section}: {json.dumps(values)}\n"
        elif values:
            comment = f"  # {_COMMENTS[section]}" if section in _COMMENTS else ""
            keys = "".join(f"  {key}: {json.dumps(value)}\n" for key, value in values.items())
            text += f"\n{section}:{comment}\n{keys}"
    names = [DRIVE_YAML] if rig is None else [RIG_YAML, DRIVE_YAML]
    with atomic_files(*(root / name for name in names)) as unfinished:
        if rig is not None:
            write_rig_yaml(rig, unfinished[0])
        unfinished[-1].write_text(text, encoding="utf-8")


def _finish(folder: Path, text: str, settings: dict[str, Any], as_json: bool) -> None:
    named = quote(str(folder))
    commands = [f"conetl inspect {named} --page inspection.html", f"conetl ingest {named}"]
    answer(as_json, {"settings": settings, "next": commands}, f"{text}\nNext: {commands[1]}")
