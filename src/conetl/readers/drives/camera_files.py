"""The files of each camera in a folder: folders of images, videos, their chapters, and images of both cameras in one folder.

drive.yaml names a stream by a folder, a file, or a pattern of files: `left/*_left.png`, or `GX??0042.MP4` of the chapters that a
GoPro splits a recording into.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from conetl.files.documents import shown
from conetl.model.errors import InputError
from conetl.model.rig import SIDES, Side
from conetl.perception.images import IMAGE_SUFFIXES
from conetl.perception.video import VIDEO_SUFFIXES, VideoFacts, video_facts
from conetl.readers.drives.drive_yaml import inside

#: Folders of images are searched so deep below a drive folder: cam0/data, sequence/left/rgb.
_DEPTH = 3
_MOST_FOLDERS = 200
#: Names of the left and the right camera, whole words of a name. Of several couples the first one counts.
_SIDES: tuple[tuple[str, str], ...] = (
    ("left", "right"), ("links", "rechts"), ("l", "r"), ("image_2", "image_3"), ("image_02", "image_03"), ("cam0", "cam1"),
    ("cam_0", "cam_1"), ("camera0", "camera1"), ("camera_0", "camera_1"), ("image_0", "image_1"), ("image_00", "image_01"),
    ("infra1", "infra2"), ("infrared_1", "infrared_2"),
)  # fmt: skip
#: Chapters of GoPro cameras: GX010042.MP4, GX020042.MP4 (two digits and the number of the recording); GOPR0042, GP010042.
_CHAPTER = re.compile(r"(G[A-Z])(\d\d)(\d{4}.*)", re.IGNORECASE)
_FIRST_CHAPTER = re.compile(r"(GO)(PR)(\d{4}.*)", re.IGNORECASE)
_WILD = frozenset("*?")


class Stream(NamedTuple):
    """The files of one camera, or of both where they are in one video."""

    name: str
    """As drive.yaml names it."""
    paths: tuple[Path, ...]
    """Images, or a video or its chapters, in the order of their names."""

    @property
    def is_video(self) -> bool:
        return self.paths[0].suffix.lower() in VIDEO_SUFFIXES


class Files(NamedTuple):
    """What a drive consists of, by the names of its files: the result of a format's `scan`."""

    left: Stream
    right: Stream
    small: Mapping[str, Path] = {}
    """Files whose content identifies the drive, by their names in it; some may not exist."""
    logs: Mapping[str, Path] = {}
    """Files that may be too long to read for a plan: trajectories and videos."""
    listed: Mapping[str, Sequence[str]] = {}
    """Names of the files in other folders."""

    @property
    def trajectory(self) -> Path:
        """The last log."""
        return [*self.logs.values()][-1]

    @property
    def image_count(self) -> int:
        """Number of frame pairs, also of those with one image: by equal names, if there are any."""
        left, right = ({path.stem for path in stream.paths} for stream in (self.left, self.right))
        return len(left | right) if left & right else max(len(left), len(right))


NO_FILES = Files(Stream("", ()), Stream("", ()))


def folder_stream(root: Path, folder: Path, name: str, remedy: str) -> Stream:
    """The images of a folder, by its name in the drive. Raises InputError where it is missing; remedy: what to do."""
    if not folder.is_dir():
        raise InputError(f"{root}: the folder {name} is missing; {remedy}")
    return Stream(name, tuple(image_files(folder)))


def names_in(data: Path, suffixes: Collection[str]) -> list[str]:
    """Sorted names of the files with one of these suffixes, without hidden ones."""
    return sorted(p.name for p in data.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith("."))


def image_files(data: Path) -> list[Path]:
    """Sorted paths of the images in a folder, without hidden files."""
    return [data / name for name in names_in(data, IMAGE_SUFFIXES)]


def find_streams(root: Path) -> list[Stream]:
    """The streams of a folder that is not a drive yet, those nearest to it: of one depth, which has two, or a video."""
    found: list[Stream] = []
    for folders in _levels(root):
        level = [stream for folder in folders for stream in _streams_in(root, folder)]
        videos = [stream for stream in level if stream.is_video]
        found += videos or level
        if videos or len(level) > 1:
            break
    return found


def stream_of(root: Path, name: str, source: str) -> Stream:
    """The stream that drive.yaml names. Raises InputError, which names `source`, where there is none inside the drive folder."""
    folder, pattern = root, ""
    if _WILD & set(name):
        parent, _, pattern = name.rpartition("/")
        folder = inside(root, parent or ".", source)
        paths = sorted(p for p in (folder.iterdir() if folder.is_dir() else ()) if fnmatch(p.name, pattern))
        paths = [p for p in paths if p.suffix.lower() in IMAGE_SUFFIXES | VIDEO_SUFFIXES and not p.name.startswith(".")]
        paths = [inside(root, path.relative_to(root).as_posix(), source) for path in paths]
    else:
        path = inside(root, name, source)
        paths = image_files(path) if path.is_dir() else [path] if path.is_file() else []
        if not paths and path.exists():
            what = "there are no images (*.jpg, *.png, *.tif, *.bmp, *.webp)"
            raise InputError(f"{path}: {what if path.is_dir() else 'this is neither a file nor a folder'}")
    if not paths:
        raise InputError(f"{source}: there is no file or folder {shown(name)} in {root}")
    if len({path.suffix.lower() in VIDEO_SUFFIXES for path in paths}) > 1:
        raise InputError(f"{source}: {shown(name)} names both videos and images; name one kind")
    _require_all_chapters(paths)
    return Stream(name, tuple(paths))


def facts_of(stream: Stream) -> VideoFacts:
    """What the headers of a video's chapters state together. Raises InputError."""
    facts = [video_facts(path) for path in stream.paths]
    return facts[0]._replace(frames=sum(f.frames for f in facts), duration_s=sum(f.duration_s for f in facts))


def sides_of(names: Sequence[str]) -> dict[Side, list[str]]:
    """Names of the streams that may be of each side: those of a known couple of cameras, else those with a letter of a side."""
    for words in _SIDES:
        left, right = ([name for name in names if _has_word(name, word)] for word in words)
        left, right = [n for n in left if n not in right], [n for n in right if n not in left]
        if left or right:
            return {"left": left, "right": right}
    return {"left": [], "right": []}


def with_likely_sides(known: Mapping[Side, str], names: Sequence[str]) -> dict[Side, str]:
    """The names of both cameras' streams, as far as they show it: of two streams, the other one is known with the first."""
    likely = sides_of(names)
    found = {side: likely[side][0] for side in SIDES if len(likely[side]) == 1} | dict(known)
    unknown = [side for side in SIDES if side not in found]
    unused = [name for name in names if name not in found.values()]
    if len(names) == 2 and len(unknown) == len(unused) == 1:
        found[unknown[0]] = unused[0]
    return found


def _levels(root: Path) -> Iterator[list[Path]]:
    """Folders of rising depth, without hidden ones and links out of the drive."""
    level = [root]
    for _ in range(_DEPTH + 1):
        yield level
        children = sorted(c for f in level for c in f.iterdir() if c.is_dir() and not c.name.startswith("."))
        level = [c for c in children if c.resolve().is_relative_to(root.resolve())][:_MOST_FOLDERS]


def _streams_in(root: Path, folder: Path) -> list[Stream]:
    """The streams whose files are directly in a folder."""
    inner = "" if folder == root else f"{folder.relative_to(root).as_posix()}/"
    parts: dict[str, list[str]] = {}
    for name in names_in(folder, VIDEO_SUFFIXES):
        parts.setdefault(_whole_recording(name), []).append(name)
    # A pattern only where there is more than one chapter.
    found = {pattern if len(names) > 1 else names[0]: names for pattern, names in parts.items()}
    if not found and (images := names_in(folder, IMAGE_SUFFIXES)):
        found = dict(_by_side(images)) or ({"": images} if len(images) > 1 or inner else {})  # a geoid is a TIFF, too
    return [
        Stream(f"{inner}{name}".rstrip("/") or ".", tuple(folder / each for each in names))
        for name, names in found.items()
    ]


def _by_side(names: Sequence[str]) -> Mapping[str, list[str]]:
    """Images of two cameras in one folder, by patterns of their names; empty where they are of one."""
    for words in _SIDES:
        patterns = [_pattern_of(names, word) for word in words]
        found = {p: [n for n in names if fnmatch(n, p)] for p in patterns if p}
        if len(found) == 2 and sum(map(len, found.values())) == len(names) == len(set().union(*found.values())):
            return found
    return {}


def _pattern_of(names: Sequence[str], word: str) -> str | None:
    """A pattern like *_left.png of the names with a word."""
    match = next((m for name in names if (m := _word(word).search(PurePosixPath(name).stem))), None)
    if match is None:
        return None
    text = match.string
    before, after = text[max(match.start() - 1, 0) : match.start()], text[match.end() : match.end() + 1]
    marks = ["" if c.isalnum() else c for c in (before, after)]
    return f"{'*' if before else ''}{marks[0]}{match[0]}{marks[1]}{'*' if after else ''}.*"


def _word(word: str) -> re.Pattern[str]:
    """A whole word: not between letters; one of a single letter or with a number at its end not beside digits either."""
    beside = "a-z" if len(word) > 1 and not word[-1].isdigit() else "a-z0-9"
    return re.compile(rf"(?<![{beside}]){re.escape(word)}(?![{beside}])", re.IGNORECASE)


def _has_word(name: str, word: str) -> bool:
    """Whether a part of a path has a word: GX010042_L.MP4, left/rgb; a long one also within a word: camLeft."""
    stem = name.rsplit(".", 1)[0].lower()
    return (word in stem) if len(word) > 3 and word.isalpha() else any(map(_word(word).search, stem.split("/")))


def _whole_recording(name: str) -> str:
    """A pattern of all chapters of the recording that a video is a part of; the name itself of other videos."""
    match = _CHAPTER.fullmatch(name) or _FIRST_CHAPTER.fullmatch(name)
    if match is None:
        return name
    # GOPR0042 is followed by GP010042: one letter is equal.
    return f"G???{match[3]}" if match[1].upper() in ("GO", "GP") else f"{match[1]}??{match[3]}"


def _require_all_chapters(paths: Sequence[Path]) -> None:
    """Raise InputError where a chapter between two others is missing: how long it was is unknown."""
    numbers = [int(m[2]) for path in paths if (m := _CHAPTER.fullmatch(path.name))]
    gap = next((a + 1 for a, b in pairwise(numbers) if b > a + 1), None)
    if gap is not None:
        raise InputError(f"{paths[0]}: chapter {gap} of this recording is missing: copy it, or name one chapter alone")
