"""When each image of a camera was taken, as its name or a file of times states it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from conetl.files.documents import read_bytes
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.perception.video import VideoIndex
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, inside
from conetl.readers.drives.pairs import ContentHash, Image, Source
from conetl.readers.drives.poses import Samples
from conetl.readers.trajectories.times import OFFSET, clock_problem, decimal_ns, parse_timestamp, times_of_names

#: A file of time stamps of `MAX_FRAMES` lines.
_MOST_TIME_BYTES = 128_000_000
_DAY_S = 86_400.0


class CameraImages(NamedTuple):
    """The images of one camera and their times from the first one on."""

    name: str
    """Name of the file, folder or pattern, for messages."""
    paths: list[Path]
    times_s: Floats
    video: VideoIndex | None
    """The video, or its first chapter."""
    sha256s: Sequence[str]
    """Hashes of the frames of a video; empty of image files, and where packets were not read."""


class UnknownTimeError(InputError):
    """The images do not show when they were taken. key: that of drive.yaml that states it; remedy: how to write it."""

    def __init__(self, key: str, root: Path, cause: str, remedy: str) -> None:
        super().__init__(f"{root}: {cause}. {remedy}")
        self.key, self.cause = key, cause


def listed(
    camera: CameraImages, name: str | None, source: Source, track: Samples | None, hint: str = ""
) -> list[Image]:
    """Images with the times of a file, one line per image, or else with those that their names are.

    Raises InputError, UnknownTimeError where no name is a time.

    The file may be the trajectory itself, with one record per image. hint: the end of the message where the file has more or
    fewer lines. track: None of a trajectory that has no times of its own.
    """
    if name is not None and name == source.settings.trajectory.file:
        assert track is not None
        if len(track.times_ns) != len(camera.paths) or track.bad:
            raise InputError(
                f"{source.root / name}: {len(track.times_ns)} valid and {len(track.bad)} bad records, but {len(camera.paths)} "
                f"images of {camera.name}: the trajectory states the times of images only if it has one record per image"
            )
        return [Image(stamp_ns, path) for stamp_ns, path in zip(track.times_ns, camera.paths, strict=True)]
    texts, doubt = _texts(camera.name, camera.paths, name, source.root, source.content, hint)
    if name is None:
        stamps: list[int | str] = [stamp(text, source.settings) for text in texts]
    else:
        stamps = _stamps(texts, source.settings, source.root)
    images = [Image(stamp, path) for stamp, path in zip(stamps, camera.paths, strict=True)]
    has_times = any(isinstance(t := image.stamp, int) and clock_problem(t) is None for image in images)
    if name is None and (doubt or not has_times):
        raise unknown_times(camera.name, camera.paths, doubt, source.settings, source.root)
    return images


def unknown_times(
    name: str, paths: Sequence[Path], doubt: str | None, settings: DriveYaml, root: Path
) -> UnknownTimeError:
    """The error where names of images are not times; doubt: why they may not be."""
    return UnknownTimeError(
        "images.timestamps",
        root,
        f"the names of the images in {name} ({paths[0].name} to {paths[-1].name}) are not times"
        + (f" to a fraction of a second ({doubt})" if doubt else "")
        + ("; images.start is for videos" if settings.images.start is not None else ""),
        f"Name a file with one time per left image in {DRIVE_YAML}: 'images: {{timestamps: left.txt}}', and "
        "right_timestamps where the right ones have others",
    )


def _texts(
    camera: str, paths: Sequence[Path], name: str | None, root: Path, content: ContentHash, hint: str = ""
) -> tuple[list[str], str | None]:
    """The time stamps of images: of the lines of a file, or else their names; and why names may not be times.

    hint: the end of the message where a file has more or fewer lines. Raises InputError.
    """
    if name is None:
        return times_of_names([path.stem for path in paths])
    file = inside(root, name, DRIVE_YAML)
    if not file.is_file():
        raise InputError(f"{file}: the time stamps of the images, which {DRIVE_YAML} names, are missing")
    data = read_bytes(file, _MOST_TIME_BYTES)
    content.add(name, data)
    texts = texts_of_file(data.decode("utf-8-sig", errors="replace").splitlines(), paths)
    if len(texts) != len(paths):
        raise InputError(
            f"{root / name}: {len(texts)} time stamps for the {len(paths)} images of {camera}, expected one line per image{hint}"
        )
    return texts, None


def texts_of_file(lines: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """The time stamps of images in the lines of a file: beside their names, or one line per image."""
    return _by_name(lines, paths) or of_images([x for x in lines if x.strip() and x[0] != "#"], paths)


def _stamps(texts: Sequence[str], settings: DriveYaml, root: Path) -> list[int | str]:
    """UTC nanoseconds of time stamps, or what is wrong with them. Raises UnknownTimeError where they count from any time."""
    if not counts_from_start(texts):
        return [stamp(text, settings) for text in texts]
    start_ns = stated_start(settings, root)
    if start_ns is None:
        raise UnknownTimeError(
            "images.start",
            root,
            f"{settings.images.timestamps or 'the names of the images'} count seconds from a time that they do not state",
            f"State the time of second 0 in {DRIVE_YAML}: 'images: {{start: 2026-03-02 10:00:00.250Z}}'",
        )
    return [start_ns + round(float(text) * 1e9) for text in texts]


def counts_from_start(texts: Sequence[str]) -> bool:
    """Whether times are seconds from the beginning of a recording: numbers that begin with 0 and do not reach a day."""
    try:
        seconds = [float(text) for text in texts]
    except ValueError:
        return False
    return bool(seconds) and 0.0 <= min(seconds) < 1.0 + 0.01 * max(seconds) and max(seconds) < _DAY_S


def of_images(lines: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """The lines that belong to images: those of their numbers where there are more lines and the names are frame numbers."""
    stems = [path.stem for path in paths]
    if len(lines) > len(stems) and all(stem.isdecimal() and int(stem) < len(lines) for stem in stems):
        return [lines[int(stem)] for stem in stems]
    return [*lines]


def _by_name(lines: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """Times by the names of images beside them (`0000.png 1772444467.25`, `1772444467.25,rgb/0000.png`); empty without names."""
    names = {path.name for path in paths}
    times: dict[str, str] = {}
    for line in lines:
        words = re.split(r"[,;\s]+", line.strip())
        found = next((word for word in words if word.rpartition("/")[2] in names), None)
        if found is not None and len(words) > 1:
            times[found.rpartition("/")[2]] = " ".join(words[1:] if words[0] == found else words[: words.index(found)])
    return [times.get(path.name, "no line of the file names this image") for path in paths] if times else []


def stamps_of_images(paths: Sequence[Path], root: Path, settings: DriveYaml) -> tuple[list[int], list[str]]:
    """Times (UTC ns) of the images of a camera, by their names or the file of their times, without those that cannot be read;
    and what was assumed of them."""
    name = settings.images.timestamps
    if name is not None and name == settings.trajectory.file:
        return [], []  # the header of a drive reads no trajectory
    texts, _ = _texts("the left camera", paths, name, root, ContentHash())
    zone = settings.timestamps_timezone
    remark = f"the times of the images state no time zone and are taken as {zone} (timestamps_timezone in {DRIVE_YAML})"
    has_zone = all(":" not in text or OFFSET.search(text) for text in texts)
    stamps = _stamps(texts, settings, root) if name is not None else [stamp(text, settings) for text in texts]
    return [time_ns for time_ns in stamps if isinstance(time_ns, int)], [] if has_zone else [remark]


def stamp(text: str, settings: DriveYaml) -> int | str:
    """UTC nanoseconds of a time stamp, or of s, ms (13 digits), us (16) or ns (19) since 1970; else what is wrong."""
    word = text.strip()
    try:
        if word.replace(".", "", 1).isdecimal():
            return decimal_ns(word, {13: 6, 16: 3, 19: 0}.get(len(word.partition(".")[0]), 9))
        return parse_timestamp(word, settings.timestamps_timezone)
    except ValueError as error:
        return str(error)


def stated_start(settings: DriveYaml, root: Path) -> int | None:
    """Time of the first left frame (UTC ns) by drive.yaml; None where it has none. Raises InputError."""
    if settings.images.start is None:
        return None
    start_ns = stamp(settings.images.start, settings)
    if isinstance(start_ns, str):
        raise InputError(f"{root / DRIVE_YAML}: images.start: {start_ns}")
    return start_ns
