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

from conetl.cli.console import JsonOption, answer, at_a_question, complain, note, say, spinner
from conetl.files.atomic import atomic_files
from conetl.files.documents import validated
from conetl.model.errors import EXIT_NEEDS_ATTENTION, ConetlError, InputError
from conetl.model.rig import SIDES, Rig
from conetl.perception.stereo_check import TRIGGER, check_stereo
from conetl.perception.video import video_facts
from conetl.readers.drives import find_format, kitti, plain, zed_recording
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, read_drive_yaml
from conetl.readers.drives.header import read_header
from conetl.readers.drives.proposal import (
    Proposal,
    Question,
    answers_in,
    outside_log,
    propose,
    stated_time,
    still_valid,
    suggested,
)
from conetl.readers.drives.summary import summarise
from conetl.readers.drives.video import NAME, Preview, preview
from conetl.readers.drives.video_timing import Timing, UnknownTimeError
from conetl.readers.rigs import RIG_YAML, write_rig_yaml
from conetl.readers.trajectories.times import parse_timestamp

_TIME_QUESTIONS = {
    "timestamps": "File with the time of each left image, one per line (UTC, or nanoseconds since 1970), or the trajectory if it "
    "has one record per image",
    "start": "Time of the first left frame, in UTC or with a UTC offset, like 2026-03-02 11:00:00.250+01:00; to the second if "
    "not known better",
    "right-offset": "Seconds by which the right file begins after the left one (0 if both start at the same trigger)",
}
#: Of a time without a fraction, like that of creation in a video's container: of a uniform distribution.
_SIGMA_OF_A_SECOND_S = 0.29
#: Answers with which the questions that come after these can be found, too.
_STAND_INS = {"layout": "left-right", "sigma": "1", "mount": "0,0,0", "right-offset": "0"}
_FILE_OPTIONS = frozenset({"left", "right", "timestamps", "right-timestamps", "trajectory", "rig"})
_COMMENTS = {
    "images": "the videos or folders of images",
    "trajectory": "the GNSS/INS log",
    "mount": "left camera relative to the antenna or IMU; if its angles may be off by 1 degree: sigmas: {pitch_deg: 1}",
    "sigmas": "of the trajectory, because its file contains none",
    "clock": "of the images relative to the trajectory",
}


def init(
    folder: Annotated[Path, typer.Argument(help="Folder with videos or images, a trajectory and a calibration.")],
    left: Annotated[str | None, typer.Option(help="File or folder of the left camera.")] = None,
    right: Annotated[str | None, typer.Option(help="File or folder of the right camera.")] = None,
    layout: Annotated[
        str | None,
        typer.Option(help="Arrangement of both images in one file: left-right, right-left, top-bottom, bottom-top."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Time of the first left frame, UTC or with an offset; default: estimated from the images."),
    ] = None,
    right_offset: Annotated[
        str | None,
        typer.Option(help="Seconds to add to the times of the right file; default: estimated from the images."),
    ] = None,
    timestamps: Annotated[
        str | None,
        typer.Option(
            help="File with the time of each left image, one per line, or the trajectory; not needed if names are times."
        ),
    ] = None,
    right_timestamps: Annotated[
        str | None, typer.Option(help="The same for the right images, if their times are different.")
    ] = None,
    every: Annotated[int | None, typer.Option(min=1, help="Use every n-th frame pair.")] = None,
    from_s: Annotated[
        float | None, typer.Option("--from", min=0.0, help="Start at this second of the left file.")
    ] = None,
    to_s: Annotated[float | None, typer.Option("--to", min=0.0, help="Stop at this second of the left file.")] = None,
    trajectory: Annotated[str | None, typer.Option(help="The GNSS/INS log.")] = None,
    date: Annotated[str | None, typer.Option(help="Date of the recording, for logs that do not contain one.")] = None,
    log_time: Annotated[
        str | None,
        typer.Option("--time", help="Time system of the log if it is not UTC: gps, or a time zone like Europe/Berlin."),
    ] = None,
    columns: Annotated[str | None, typer.Option(help="Columns of a table, like time=Zeit,lat=B,lon=3.")] = None,
    crs: Annotated[str | None, typer.Option(help="CRS of the log's positions, like EPSG:25832.")] = None,
    heights: Annotated[str | None, typer.Option(help="Heights: ellipsoidal, unknown, or a CRS like EPSG:5773.")] = None,
    sigma: Annotated[str | None, typer.Option(help="Horizontal sigma in metres, if the log contains none.")] = None,
    rig: Annotated[
        str | None, typer.Option(help="Calibration of the cameras, in any format of `conetl rig convert`.")
    ] = None,
    mount: Annotated[
        str | None,
        typer.Option(
            help="Left camera relative to the antenna or IMU: metres forward, left, up, then optionally pitch, yaw and roll "
            "in degrees, like 1.2,0.3,-0.2,3."
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask; fail if a value is missing.")] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Rewrite an existing drive.yaml; other settings are kept.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Turn a folder with video or images, a GNSS/INS log and a calibration into a drive: write its drive.yaml.

    In a terminal it asks for missing values. Elsewhere, or with --yes, it lists the options that are required.
    """
    root = folder.resolve()
    if not root.is_dir():
        raise zed_recording(folder) or InputError(f"{folder}: there is no such folder")
    kind = find_format(root)
    # Folders called left and right may be a plain drive, or images with a log of any format; a drive.yaml alone is no drive.
    poses = root / (plain.TRAJECTORY if kind is plain else "oxts")
    lacks_poses = kind in (plain, kitti) and not poses.exists()
    if kind is not None and kind.NAME != NAME and not lacks_poses:
        _finish(folder, f"{folder} is already a drive ({kind.NAME}); it needs no drive.yaml.", {}, as_json)
        return
    if (root / DRIVE_YAML).exists() and not force:
        raise InputError(f"{root / DRIVE_YAML} already exists: edit it, or use --force to rewrite it")
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
        say(f"  kept from {DRIVE_YAML}: {_listed(kept)} (delete the file to start over)")
    answers = answers_in(kept) | given
    kept["images"] = kept.get("images", {}) | part
    asks = sys.stdin.isatty() and not yes and not as_json
    settings, found, new_rig = _settled(root, answers, kept, asks=asks, as_json=as_json)
    _add_timing(settings, found.timing)
    text = f"{folder / DRIVE_YAML}: {_counted(found)}"
    if "clock" not in settings and _to_the_second(answers.get("start")):
        settings["clock"] = {"offset_s": 0.0, "sigma_s": _SIGMA_OF_A_SECOND_S}
        driven = summarise(found.drive, found.rejections)
        along_m = _SIGMA_OF_A_SECOND_S * driven.length_m / max(driven.duration_s, _SIGMA_OF_A_SECOND_S)
        text += (
            f"\nThe time of the first left frame is given in whole seconds, so its sigma is {_SIGMA_OF_A_SECOND_S} s, and that "
            f"of positions along the road becomes {along_m:.1f} m. If it is exact, state milliseconds, like 11:00:00.000."
        )
    _write(root, settings, new_rig)
    start_ns, sigma_s = found.timing.start_ns, found.timing.clock.sigma_s
    if start_ns is not None and found.timing.right_offset_s and not answers.keys() & {"right-offset", "layout"}:
        text += (
            f"\nEstimated from the images: the right file begins {found.timing.right_offset_s:g} s after the left one."
        )
    if start_ns is not None and sigma_s and "start" not in answers:
        text += (
            f"\nTime of the first left frame, estimated from the images: {stated_time(start_ns)} +-{1000 * sigma_s:.0f} ms. "
            "If you know the exact time, set --start."
        )
    note(*read_header(root).remarks)
    _finish(folder, text, settings, as_json)


def _to_the_second(start: str | None) -> bool:
    """Whether a time is stated without a fraction of a second."""
    return start is not None and not {".", ","} & set(start) and parse_timestamp(start) % 10**9 == 0


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
    except InputError as error:
        complain(f"{error}\nconetl ignores this file and writes a new one.")
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
            proposal = propose(root, answers, asks=asks)
        except ConetlError as error:
            if asked is None:
                raise
            say(_refused(asked.key, answers[asked.key], str(error)))
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
                questions = [_of_time(root, settings, error)]
            except ConetlError as error:
                _write(root, settings, proposal.rig)
                complain(
                    f"{root / DRIVE_YAML} was written, but the drive cannot be read yet:\n{error}\nEdit the file, or run this "
                    "command again with --force and corrected options."
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
    with spinner("estimating the times of the images"):
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


def _of_time(root: Path, settings: Mapping[str, Any], error: UnknownTimeError) -> Question:
    """The question for a time, with an answer if the trajectory has one."""
    text, known = _TIME_QUESTIONS[error.key], suggested(root, settings, error.key)
    if known is None:
        return Question(error.key, text, cause=error.cause)
    return Question(error.key, text, default=known[0], cause=f"{error.cause}. {known[1]}")


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
                    questions = [_of_time(root, settings, error)]
    lines = "\n".join(f"  --{key}: {text}" for key, text in texts.items())
    return f"{root}: these values are missing; set them with these options:\n{lines}"


def _refused(key: str, value: str, error: str) -> str:
    """What is wrong with an answer, before its question is repeated: the option was not typed, so it is not named."""
    reason = error.removeprefix(f"--{key}").lstrip(": ")
    return f"{value}: {error}" if reason == error else reason


def _answer(question: Question) -> str:
    default, shown = question.default or "", question.default is not None
    while True:
        with at_a_question():
            if text := str(typer.prompt(question.text, default=default, show_default=shown)).strip():
                return text
        say("This value is required. To look it up first, press Ctrl-C; nothing has been written.")


def _add_timing(settings: dict[str, Any], timing: Timing) -> None:
    """What the images showed, so that it is not searched again."""
    images = settings["images"]
    if timing.start_ns is not None:
        images["start"] = stated_time(timing.start_ns)
        if "layout" not in images:
            images["right_offset_s"] = round(timing.right_offset_s, 6)
    if timing.clock.sigma_s:
        settings["clock"] = {"offset_s": 0.0, "sigma_s": round(timing.clock.sigma_s, 4)}


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
