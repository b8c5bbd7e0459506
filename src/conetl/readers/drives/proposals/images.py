"""The images of a folder for `conetl init`: which files are of which camera, and when they were taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from conetl.model.base import utc_from_ns
from conetl.model.errors import InputError
from conetl.model.rig import SIDES
from conetl.perception.video import VIDEO_SUFFIXES, video_facts
from conetl.readers.drives import find_format, zed_recording
from conetl.readers.drives.camera_files import Stream, facts_of, find_streams, names_in, stream_of, with_likely_sides
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.image_times import (
    UnknownTimeError,
    counts_from_start,
    has_times,
    stated_start,
    times_in,
    times_of,
)
from conetl.readers.drives.pairs import ContentHash, Source, first_size
from conetl.readers.drives.proposals.log_and_rig import rigs_in
from conetl.readers.drives.proposals.template import FILE_KEYS, TABLE_SUFFIXES, Missing, Proposal, value_at
from conetl.readers.rigs import read_given_rig
from conetl.readers.trajectories.recorded import RecordedTrajectory


def add_images(root: Path, rig_file: Path | None, proposal: Proposal) -> tuple[int, int] | None:
    """Size of the images of one camera, where it is known."""
    images = proposal.settings.setdefault("images", {})
    _check_images(root, proposal.settings)
    inside = [child for child in sorted(root.iterdir()) if find_format(child)]
    streams = find_streams(root)
    if not streams or any(all(s.paths[0].is_relative_to(child) for s in streams) for child in inside):
        if (error := zed_recording(root)) is not None:
            raise error
        hint = f"; {inside[0].name} is a drive already: conetl ingest {inside[0]}" if inside else ""
        raise InputError(
            f"{root}: there are no videos ({', '.join(sorted(VIDEO_SUFFIXES))}) and no folders of images here{hint}"
        )
    _refuse_single_frames(streams)
    names = [stream.name for stream in streams]
    proposal.found.extend(_shown(streams))
    if len(streams) == 1 or "layout" in images:
        images.setdefault("left", names[0])
        stream = stream_of(root, images["left"], "images.left")
        if stream.is_video and "layout" not in images and (layout := _layout_of(root, rig_file, stream)) is not None:
            images["layout"] = layout
            proposal.found.append(f"{images['left']}: layout {layout}, by the size of the calibration")
        proposal.need("images.layout")
    else:
        images |= with_likely_sides({side: images[side] for side in SIDES if side in images}, names)
        unknown = [side for side in SIDES if side not in images]
        for side in unknown[:1] if len(names) == 2 else unknown:
            proposal.need(f"images.{side}", f"Found: {', '.join(names)}")
    if "left" not in images or "images.layout" in (each.key for each in proposal.missing):
        return None
    left = stream_of(root, images["left"], "images.left")
    if not left.is_video:
        _add_times(root, left, proposal)
        return first_size(left.paths)
    if "timestamps" not in images:
        proposal.need("images.start", "otherwise it is searched in the images", required=False)
    facts, layout = video_facts(left.paths[0]), images.get("layout", "")
    across, down = 2 if "left" in layout else 1, 2 if "top" in layout else 1
    return facts.width_px // across, facts.height_px // down


def _refuse_single_frames(streams: Sequence[Stream]) -> None:
    """Raise InputError for frames of KITTI's object benchmark, which are not consecutive."""
    for stream in streams:
        calibrations = stream.paths[0].parent.parent / "calib"
        if calibrations.is_dir() and {p.stem for p in stream.paths} <= {p.stem for p in calibrations.glob("*.txt")}:
            raise InputError(
                f"{calibrations}: there is one calibration per image, so these are single frames (KITTI object) and no drive; "
                "locate what they show with 'conetl locate'"
            )


def _shown(streams: Sequence[Stream]) -> list[str]:
    """What the streams are, those that are alike in one line."""
    alike: dict[str, list[str]] = {}
    for stream in streams:
        name = stream.name if stream.is_video else f"{stream.name}/" if "*" not in stream.name else stream.name
        if not stream.is_video:
            alike[f"images in {name}: {len(stream.paths):,}"] = []
            continue
        facts = facts_of(stream)
        rate = facts.frames / facts.duration_s if facts.duration_s else 0.0
        chapters = f", {len(stream.paths)} chapters" if len(stream.paths) > 1 else ""
        size, lasts = f"{facts.width_px} x {facts.height_px}", f"{rate:.2f} Hz, {facts.duration_s:.0f} s"
        alike.setdefault(f"{size}, {facts.frames:,} frames, {lasts}{chapters}", []).append(name)
    return [f"video {' and '.join(names)}: {text}" if names else text for text, names in alike.items()]


def _layout_of(root: Path, rig_file: Path | None, stream: Stream) -> str | None:
    """How both images lie in each frame of the only video, left or top first, if a calibration is for one half of the frame."""

    def fits(size: tuple[int, int]) -> bool:
        if rig_file is None:
            return bool(rigs_in(root, size).fitting)
        camera = read_given_rig(rig_file, size)[0].left
        return (camera.width_px, camera.height_px) == size

    facts = video_facts(stream.paths[0])
    width_px, height_px = facts.width_px, facts.height_px
    halves = {"left-right": (width_px // 2, height_px), "top-bottom": (width_px, height_px // 2)}
    fitting = [layout for layout, size in halves.items() if fits(size)]
    return fitting[0] if len(fitting) == 1 and not fits((width_px, height_px)) else None


def _add_times(root: Path, left: Stream, proposal: Proposal) -> None:
    """The times of image files: those of their names, or of the only file that has one for each of them."""
    images, settings = proposal.settings["images"], DriveYaml.model_validate(proposal.settings)
    if "timestamps" not in images:
        try:
            times_of(left.name, left.paths, None, Source(root, root, settings, ContentHash()))
            return
        except UnknownTimeError as error:
            above = left.paths[0].parent.parents
            folders = sorted({root, left.paths[0].parent, *(f for f in above if f.is_relative_to(root))})
            files = [folder / name for folder in folders for name in names_in(folder, TABLE_SUFFIXES)]
            names = [file.relative_to(root).as_posix() for file in files if has_times(file, left.paths, settings)]
            sides = with_likely_sides({}, names) if len(names) == len(SIDES) else {}
            if len(sides) == len(SIDES):
                images["right_timestamps"], names = sides["right"], [sides["left"]]
            if len(names) != 1:
                found = f"{', '.join(names)} each have one time per image. " if names else ""
                proposal.need(error.key, found + error.cause)
                return
        images["timestamps"] = names[0]
        proposal.found.append(f"times of the images: {names[0]}")
    file = root / images["timestamps"]
    if file.is_file() and counts_from_start(times_in(file, left.paths)):
        changed = f"{np.datetime64(int(file.stat().st_mtime), 's')}Z".replace("T", " ")
        cause = f"{file.name} counts seconds from a time that it does not state; it was last changed at {changed}"
        proposal.need("images.start", cause, changed)


def _check_images(root: Path, settings: Mapping[str, Any]) -> None:
    """Raise InputError for files that are not there, and for a start that cannot be read."""
    for key in FILE_KEYS:
        name = value_at(settings, key)
        if key in ("images.left", "images.right") and name is not None:
            stream_of(root, name, key)
        elif name is not None and not (root / name).exists():
            raise InputError(f"{key}: there is no file or folder {name} in {root}")
    stated_start(DriveYaml.model_validate(settings), root)


def check_start(root: Path, settings: Mapping[str, Any], recorded: RecordedTrajectory) -> None:
    """Raise InputError where no part of the video, by its stated start, is within the time of the trajectory."""
    images, left = settings["images"], stream_of(root, settings["images"]["left"], "images.left")
    start_ns = stated_start(DriveYaml.model_validate(settings), root)
    if start_ns is None or "clock" in settings or not left.is_video:
        return
    times_ns = recorded.times_ns
    if start_ns <= times_ns[-1] and start_ns + 1e9 * facts_of(left).duration_s >= times_ns[0]:
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
    root: Path, settings: Mapping[str, Any], recorded: RecordedTrajectory | None, missing: Missing
) -> Missing:
    """A missing time with what the trajectory proposes for it, where that has a record per left image."""
    name = settings["images"].get("left")
    if missing.key not in ("images.start", "images.timestamps") or name is None or recorded is None:
        return missing
    left, log = stream_of(root, name, "images.left"), settings["trajectory"]["file"]
    times_ns, count = recorded.times_ns, len(recorded.times_ns)
    if missing.key == "images.timestamps":
        if left.is_video or count != len(left.paths) or recorded.bad:
            return missing
        value, reason = log, f"{log} has one record per image; if each states the time of its image, name this file"
    else:
        facts, span_s = facts_of(left) if left.is_video else None, float(times_ns[-1] - times_ns[0]) * 1e-9
        apart_s = 2 * span_s / max(count - 1, 1)
        if facts is None or count != facts.frames or abs(span_s - facts.duration_s) > apart_s:
            return missing
        value = stated_time(int(times_ns[0]))
        reason = f"{log} has one record per frame; if the first is of the first frame, that was at {value}"
    return missing._replace(cause=". ".join(filter(None, (missing.cause, reason))), suggestion=value)
