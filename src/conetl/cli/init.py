"""`conetl init`: make a drive of a folder with stereo video or images, a trajectory and a calibration."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, NoReturn

import typer

from conetl.cli.console import JsonOption, answer, at_a_question, complain, note, print_json, say, spinner
from conetl.files.atomic import atomic_files
from conetl.files.documents import parse_yaml, shown, validated
from conetl.geometry.motion.rolling_shutter import shutter_of
from conetl.model.drive import Drive
from conetl.model.errors import EXIT_NEEDS_ATTENTION, ConetlError, InputError
from conetl.model.rig import SIDES, Rig
from conetl.perception.checks.stereo_check import TRIGGER, check_stereo
from conetl.perception.video import frame_of, video_facts
from conetl.readers.drives import find_format, kitti, plain, proposals, zed_recording
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, read_drive_yaml, stated
from conetl.readers.drives.header import read_header
from conetl.readers.drives.image_times import UnknownTimeError
from conetl.readers.drives.proposals import Proposal, template
from conetl.readers.drives.proposals.template import FILE_KEYS, RIG, Missing, in_yaml, is_text
from conetl.readers.drives.summary import summarise
from conetl.readers.drives.video import NAME, Preview, preview
from conetl.readers.drives.video_timing import Timing
from conetl.readers.rigs import RIG_YAML, write_rig_yaml
from conetl.readers.trajectories.times import parse_timestamp

#: Of a time without a fraction, like that of creation in a video's container: of a uniform distribution.
_SIGMA_OF_A_SECOND_S = 0.29


def init(
    folder: Annotated[Path, typer.Argument(help="Folder with videos or images, a trajectory and a calibration.")],
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Value of a key of drive.yaml, like images.every=2, instead of what the folder or an earlier drive.yaml states; "
            "may be repeated. Without a value the key is removed.",
        ),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option(help="Calibration of the cameras, in any format of `conetl rig convert`.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Take every value that is proposed.")] = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Rewrite a drive.yaml that init did not write: its settings are kept, not its comments."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Turn a folder with video or images, a GNSS/INS log and a calibration into a drive: write its drive.yaml.

    Values that the folder does not show are listed once, all together, with the reason and a proposal where there is one. On a
    terminal they are asked for; otherwise state them with --set, take what is proposed with --yes, or fill them into drive.yaml
    and run init again.
    """
    root = folder.resolve()
    if not root.is_dir():
        raise zed_recording(folder) or InputError(f"{folder}: there is no such folder")
    given = _given(root, values or [])
    if (drive_format := _format_of_drive(root)) is not None:
        if given or rig is not None:
            raise InputError(f"{folder} is already a drive ({drive_format}): write its settings into {DRIVE_YAML}")
        _finish(folder, f"{folder} is already a drive ({drive_format}); it needs no {DRIVE_YAML}.", {}, as_json)
        return
    kept = proposals.still_valid(_earlier(root, force=force), _with({}, given))
    if kept and not as_json:
        say(f"  kept from {DRIVE_YAML}: {', '.join(kept)} (delete the file to start over)")
    stated_now = validated(stated(_with(kept, given)), DriveYaml, "--set").model_dump(mode="json", exclude_unset=True)
    rig_file = None if rig is None else root / _as_in_folder(root, str(rig))
    proposal = proposals.propose(root, stated_now, rig_file)
    for line in () if as_json else proposal.found:
        say(f"  {line}")
    if any(each.required for each in proposal.missing):
        answers = _answers(folder, proposal.missing, yes=yes, as_json=as_json)
        if RIG in answers:
            rig_file = root / _as_in_folder(root, str(answers.pop(RIG)))
        if answers or rig_file is not None:
            answered = validated(stated(_with(proposal.settings, answers)), DriveYaml, "--set")
            proposal = proposals.propose(root, answered.model_dump(mode="json", exclude_unset=True), rig_file)
    settings, stated_images = proposal.settings, dict(proposal.settings["images"])
    found, missing = _tried(root, proposal)
    if found is None:
        _write(root, settings, missing, None if rig_file is None else proposal.rig)  # one that was found is found again
        _stop(folder, settings, missing, as_json)
    _add_timing(settings, found.timing)
    text = f"{folder / DRIVE_YAML}: {_counted(found)}"
    # Poses with one row per image have the times of the images.
    if "clock" not in settings and proposal.recorded is not None and _to_the_second(stated_images.get("start")):
        settings["clock"] = {"offset_s": 0.0, "sigma_s": _SIGMA_OF_A_SECOND_S}
        text += _of_whole_seconds(found)
    _write(root, settings, [], proposal.rig)
    header = read_header(root)
    note(*header.remarks)
    if header.problem is not None:
        raise _unreadable(root, header.problem)
    _finish(folder, text + _estimated(found.timing, stated_images) + _unknown_readout(found.drive), settings, as_json)


def _format_of_drive(root: Path) -> str | None:
    """Name of the format of a folder that is a drive without `init`."""
    kind = find_format(root)
    # Folders called left and right may be a plain drive, or images with a log of any format; a drive.yaml alone is no drive.
    poses = root / (plain.TRAJECTORY if kind is plain else "oxts")
    lacks_poses = kind in (plain, kitti) and not poses.exists()
    return None if kind is None or kind.NAME == NAME or lacks_poses else kind.NAME


# --------------------------------------------------------------------------- what is stated


def _given(root: Path, texts: Sequence[str]) -> dict[str, Any]:
    """The values of `--set`, by their keys with dots between the levels. Raises InputError."""
    given: dict[str, Any] = {}
    for text in texts:
        key, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not key:
            raise InputError(f"--set {shown(text)}: expected KEY=VALUE, like images.every=2")
        if not template.is_key(key):
            near = template.similar_keys(key)
            hint = f"did you mean {' or '.join(near)}?" if near else "they are listed in docs/reference/drive_yaml.md"
            raise InputError(f"--set {key}: {DRIVE_YAML} has no such key; {hint}")
        given[key] = (value or None) if is_text(key) else parse_yaml(f"--set {key}", value)
        if key in FILE_KEYS and isinstance(given[key], str):
            given[key] = _as_in_folder(root, given[key])
    return given


def _with(settings: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The same settings, with values by keys with dots between the levels. Raises InputError."""
    for key, value in values.items():
        *sections, name = key.split(".")
        inner = settings
        for section in sections:
            inner = inner.setdefault(section, {})
            if not isinstance(inner, dict):
                raise InputError(f"--set {key}: {section} is {shown(inner)}, which has no keys")
        inner[name] = value
    return settings


def _as_in_folder(root: Path, name: str) -> str:
    """The name of a file as seen from the drive folder; it may be named from the current one."""
    if (root / name).exists() or not Path(name).exists():
        return name
    path = Path(name).resolve()
    return str(path.relative_to(root) if path.is_relative_to(root) else path)


def _earlier(root: Path, *, force: bool) -> dict[str, Any]:
    """What an earlier drive.yaml states. Raises InputError where its comments or errors are those of a person."""
    path = root / DRIVE_YAML
    if path.is_file() and not force and not template.is_template(path):
        raise InputError(
            f"{path} was not written by 'conetl init': edit it, or use --force to rewrite it: its settings are kept, its "
            "comments are not"
        )
    return read_drive_yaml(root).model_dump(mode="json", exclude_unset=True)


# --------------------------------------------------------------------------- what the images show


def _tried(root: Path, proposal: Proposal) -> tuple[Preview | None, list[Missing]]:
    """The drive of a proposal, or what is still missing, also the times that the images do not show.

    Raises ConetlError where the drive cannot be read for another reason; it is written, for a person to correct it.
    """
    if any(each.required for each in proposal.missing):
        return None, proposal.missing
    if proposal.recorded is not None:
        proposals.check_start(root, proposal.settings, proposal.recorded)
    try:
        return _previewed(root, proposal.settings, proposal.rig), []
    except UnknownTimeError as error:
        return None, [proposals.suggested(root, proposal.settings, proposal.recorded, Missing(error.key, error.cause))]
    except ConetlError as error:
        _write(root, proposal.settings, [], proposal.rig)
        raise _unreadable(root, str(error)) from error


def _unreadable(root: Path, problem: str) -> typer.Exit:
    """The end of the command where the drive that it wrote cannot be read."""
    complain(
        f"{root / DRIVE_YAML} was written, but the drive cannot be read yet:\n{problem}\n"
        "Edit the file or use --set, and run this command again."
    )
    return typer.Exit(EXIT_NEEDS_ATTENTION)


def _previewed(root: Path, settings: Mapping[str, Any], rig: Rig | None) -> Preview:
    """The drive of settings that are not written yet. Raises ConetlError.

    On a smooth road a right file with as many frames as the left one is not shifted if its images fit so better than otherwise.
    """
    with spinner("estimating the times of the images"):
        try:
            return preview(root, DriveYaml.model_validate(settings), rig)
        except UnknownTimeError as error:
            images = settings["images"]
            if (
                error.key != "images.right_offset_s"
                or len({video_facts(root / images[side]).frames for side in SIDES}) > 1
            ):
                raise
            together = {**settings, "images": {**images, "right_offset_s": 0.0}}
            found = preview(root, DriveYaml.model_validate(together), rig)
            if any(finding.value != 0 for finding in check_stereo(found.drive)[1] if finding.check == TRIGGER):
                raise
            return found


def _add_timing(settings: dict[str, Any], timing: Timing) -> None:
    """What the images showed, so that it is not searched again."""
    images = settings["images"]
    if timing.start_ns is not None:
        images["start"] = proposals.stated_time(timing.start_ns)
        if "layout" not in images:
            images["right_offset_s"] = round(timing.right_offset_s, 6)
    if timing.clock.sigma_s:
        settings["clock"] = {"offset_s": 0.0, "sigma_s": round(timing.clock.sigma_s, 4)}


def _to_the_second(start: str | None) -> bool:
    """Whether a time is stated without a fraction of a second."""
    return start is not None and not {".", ","} & set(start) and parse_timestamp(start) % 10**9 == 0


# --------------------------------------------------------------------------- results


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


def _of_whole_seconds(found: Preview) -> str:
    """What it means that the time of the first frame is stated without a fraction of a second."""
    driven = summarise(found.drive, found.rejections)
    along_m = _SIGMA_OF_A_SECOND_S * driven.length_m / max(driven.duration_s, _SIGMA_OF_A_SECOND_S)
    return (
        f"\nThe time of the first left frame is given in whole seconds, so its sigma is {_SIGMA_OF_A_SECOND_S} s, and that "
        f"of positions along the road becomes {along_m:.1f} m. If it is exact, state milliseconds, like 11:00:00.000."
    )


def _estimated(timing: Timing, stated_images: Mapping[str, Any]) -> str:
    """What was found from the images. stated_images: that section of drive.yaml without it."""
    text = ""
    if (
        timing.start_ns is not None
        and timing.right_offset_s
        and not stated_images.keys() & {"right_offset_s", "layout"}
    ):
        text += f"\nEstimated from the images: the right file begins {timing.right_offset_s:g} s after the left one."
    if timing.start_ns is not None and timing.clock.sigma_s and "start" not in stated_images:
        text += (
            f"\nTime of the first left frame, estimated from the images: {proposals.stated_time(timing.start_ns)} "
            f"+-{1000 * timing.clock.sigma_s:.0f} ms. If you know the exact time, set images.start."
        )
    return text


def _unknown_readout(drive: Drive) -> str:
    """A question about the rolling shutter, for video whose readout is not stated."""
    if frame_of(drive.frame_pairs[0].left_path) is None or shutter_of(drive.rig, "left") is not None:
        return ""
    return (
        "\nDo the cameras read their rows one after the other (rolling shutter), as most video cameras and phones do? State them "
        "with --set shutter.readout_ms=MS (0: global shutter) and --set shutter.stamp_row=first, middle or last. Otherwise the "
        "readout is estimated from the images, and positions get larger sigmas."
    )


def _write(root: Path, settings: Mapping[str, Any], missing: Sequence[Missing], rig: Rig | None) -> None:
    """drive.yaml, and rig.yaml where there is a rig: both or neither."""
    names = [DRIVE_YAML] if rig is None else [RIG_YAML, DRIVE_YAML]
    with atomic_files(*(root / name for name in names)) as unfinished:
        if rig is not None:
            write_rig_yaml(rig, unfinished[0])
        unfinished[-1].write_text(
            template.template(settings, [each for each in missing if each.required]), encoding="utf-8"
        )


# --------------------------------------------------------------------------- questions


def _answers(folder: Path, missing: Sequence[Missing], *, yes: bool, as_json: bool) -> dict[str, Any]:
    """Values of what is missing, by their keys: those that are proposed, or else those that a person types at a terminal."""
    if yes:
        taken = [each for each in missing if each.suggestion is not None and each.required]
        for each in () if as_json else taken:
            say(f"  {each.key} {in_yaml(each.suggestion)}, as proposed: {each.text}")
        return {each.key: each.suggestion for each in taken}
    if as_json or not _is_terminal():
        return {}
    say(f"{folder}: these values are missing:\n{_listed(missing)}")
    answers: dict[str, Any] = {}
    with at_a_question():
        for each in missing:
            proposed = each.suggestion if is_text(each.key) or each.suggestion is None else in_yaml(each.suggestion)
            text = str(typer.prompt(each.key, default=proposed or "", show_default=proposed is not None)).strip()
            if text:
                answers[each.key] = text if each.key == RIG or is_text(each.key) else parse_yaml(each.key, text)
    return answers


def _is_terminal() -> bool:
    """Whether a person can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _listed(missing: Sequence[Missing]) -> str:
    """The values, each with its option, the reason and what is proposed."""
    text = ""
    for each in missing:
        proposed = f". --yes takes {in_yaml(each.suggestion)}" if each.suggestion is not None else ""
        text += f"  {_as_option(each)}\n      {each.text}{proposed if each.required else '. May be left out.'}\n"
    return text


def _as_option(missing: Missing) -> str:
    """The option that states a value, with an example."""
    if missing.key == RIG:
        return "--rig FILE"
    return f"--set {quote(f'{missing.key}={missing.example.strip(chr(39))}')}"


def _stop(folder: Path, settings: Mapping[str, Any], missing: Sequence[Missing], as_json: bool) -> NoReturn:
    """List what is missing."""
    again = f"conetl init {quote(str(folder))}"
    if as_json:
        names = ("option", "key", "text", "proposal", "required")
        values = ((_as_option(each), each.key, each.text, each.suggestion, each.required) for each in missing)
        listed = [dict(zip(names, each, strict=True)) for each in values]
        print_json({"settings": settings, "missing": listed, "next": [again]})
    complain(
        f"{folder / DRIVE_YAML} was written, but these values are missing:\n{_listed(missing)}State them with these options, or "
        f"write them into {DRIVE_YAML}, and run again: {again}"
    )
    raise typer.Exit(EXIT_NEEDS_ATTENTION)


def _finish(folder: Path, text: str, settings: Mapping[str, Any], as_json: bool) -> None:
    named = quote(str(folder))
    commands = [f"conetl inspect {named} --page inspection.html", f"conetl ingest {named}"]
    answer(as_json, {"settings": settings, "missing": [], "next": commands}, f"{text}\nNext: {commands[1]}")
