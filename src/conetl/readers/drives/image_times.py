"""When each image of a camera was taken, as its name or a file of times states it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from conetl.files.documents import read_table_bytes, table_lines
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.perception.video import VideoIndex
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, named_in_yaml
from conetl.readers.drives.pairs import Image, Source
from conetl.readers.drives.poses import Samples
from conetl.readers.trajectories import trajectory_format
from conetl.readers.trajectories.times import clock_problem, decimal_ns, parse_timestamp, times_of_names

#: Larger ones are not looked for.
_MOST_TRIED_BYTES = 4_000_000
_DAY_S = 86_400.0


class CameraImages(NamedTuple):
    """The images of one camera and their times from the first one on."""

    name: str
    """Name of the file, folder or pattern, for messages."""
    paths: list[Path]
    times_s: Floats
    video: VideoIndex | None
    """The video, or its first chapter."""
    sha256s: Sequence[str | None]
    """Hashes of the frames of a video, empty where packets were not read; None of image files."""

    def at(self, stamps: Sequence[int | str]) -> list[Image]:
        """The images with these times."""
        return [Image(*each) for each in zip(stamps, self.paths, [None] * len(self.paths), self.sha256s, strict=True)]

    def from_start(self, start_ns: int) -> list[Image]:
        """The images of a video that began then."""
        return self.at([start_ns + round(time_s * 1e9) for time_s in self.times_s.tolist()])


class UnknownTimeError(InputError):
    """The images do not show when they were taken. key: that of drive.yaml that states it; remedy: how to write it."""

    def __init__(self, key: str, root: Path, cause: str, remedy: str) -> None:
        super().__init__(f"{root}: {cause}. {remedy}")
        self.key, self.cause = key, cause


def listed(
    camera: CameraImages, name: str | None, source: Source, track: Samples | None, hint: str = ""
) -> list[Image]:
    """Images with the times of a file, one line per image, or else with those that their names are; see `times_of`.

    The file may be the trajectory itself, with one record per image. track: None of a trajectory that has no times of its own.
    """
    if name is None or name != source.settings.trajectory.file:
        return camera.at(times_of(camera.name, camera.paths, name, source, hint)[0])
    assert track is not None
    if len(track.times_ns) != len(camera.paths) or track.bad:
        raise InputError(
            f"{source.root / name}: {len(track.times_ns)} valid and {len(track.bad)} bad records, but {len(camera.paths)} "
            f"images of {camera.name}: the trajectory states the times of images only if it has one record per image"
        )
    return camera.at(track.times_ns)


def times_of(
    camera: str, paths: Sequence[Path], name: str | None, source: Source, hint: str = ""
) -> tuple[list[int | str], list[str]]:
    """Times (UTC ns) of the images of a camera, or what is wrong with them, and the texts that state them.

    name: of the file with their times; None: their names are. hint: the end of the message where the file has more or fewer
    lines. Raises InputError; UnknownTimeError where no name is a time, or where times count from a time that nothing states.
    """
    root, settings = source.root, source.settings
    if name is None:
        texts, doubt = times_of_names([path.stem for path in paths])
        stamps = [stamp(text, settings) for text in texts]
        if doubt is None and any(isinstance(t, int) and clock_problem(t) is None for t in stamps):
            return stamps, texts
        cause = f"the names of the images in {camera} ({paths[0].name} to {paths[-1].name}) are not times"
        cause += f" to a fraction of a second ({doubt})" if doubt else ""
        cause += "; images.start is for videos" if settings.images.start is not None else ""
        remedy = f"Name a file with one time per left image in {DRIVE_YAML}: 'images: {{timestamps: left.txt}}', and "
        remedy += "right_timestamps where the right ones have others"
        raise UnknownTimeError("images.timestamps", root, cause, remedy)
    data = read_table_bytes(named_in_yaml(root, name, "the time stamps of the images are"), len(paths))
    source.content.add(name, data)
    texts = texts_of_file([*table_lines(data)], paths)
    if len(texts) != len(paths):
        raise InputError(
            f"{root / name}: {len(texts)} time stamps for the {len(paths)} images of {camera}, expected one line per image{hint}"
        )
    if not counts_from_start(texts):
        return [stamp(text, settings) for text in texts], texts
    start_ns = stated_start(settings, root)
    if start_ns is None:
        cause = f"{name} counts seconds from a time that it does not state"
        remedy = f"State the time of second 0 in {DRIVE_YAML}: 'images: {{start: 2026-03-02 10:00:00.250Z}}'"
        raise UnknownTimeError("images.start", root, cause, remedy)
    return [start_ns + round(float(text) * 1e9) for text in texts], texts


def texts_of_file(lines: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """The time stamps of images in the lines of a file: beside their names, behind their numbers, or one line per image."""
    if found := _by_name(lines, paths):
        return found
    rows = [line.strip() for line in lines if line.strip() and line[0] != "#"]
    if rows[1:] and rows[0][0].isalpha() and rows[1][0].isdigit():  # names of the columns
        rows = rows[1:]
    numbers, *times = zip(*(re.split(r"[,;\s]+", row, maxsplit=1) for row in rows), strict=False) if rows else [()]
    counted = [str(n) for n in range(len(rows))], [str(n) for n in range(1, len(rows) + 1)]
    if times and len(times[0]) == len(rows) > 1 and [number.lstrip("0") or "0" for number in numbers] in counted:
        rows = [*times[0]]
    return of_images(rows, paths)


def times_in(path: Path, paths: Sequence[Path]) -> list[str]:
    """The time stamps of images in a file."""
    return texts_of_file(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), paths)


def has_times(path: Path, paths: Sequence[Path], settings: DriveYaml) -> bool:
    """Whether a file has one time per image, and nothing else."""
    if not path.is_file() or path.stat().st_size > _MOST_TRIED_BYTES:
        return False
    texts = times_in(path, paths)
    if len(texts) != len(paths) or trajectory_format(path) is not None:
        return False
    good = [isinstance(t := stamp(text, settings), int) and not clock_problem(t) for text in texts]
    return counts_from_start(texts) or sum(good) > len(texts) // 2


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
