"""What a module of one drive format provides, and what the headers of all formats share."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Protocol

from conetl.files.storage import is_remote
from conetl.model.errors import DriveFolderError
from conetl.model.records import Drive, FramePair, Rig
from conetl.model.rejections import Rejection
from conetl.readers.drives.content import ContentHash
from conetl.readers.drives.drive_yaml import DriveYaml
from conetl.readers.drives.pairs import IMAGE_SUFFIXES, require_pairs
from conetl.readers.drives.timestamps import misplaced

#: Images per side whose size is part of the header: a drive delivered again with other images is another drive.
SAMPLED_IMAGES = 16
#: Pose files, or pieces of a trajectory, that are part of the header: corrected poses often have as many digits.
SAMPLED_POSES = 16
_SAMPLED_BYTES = 4096


class ReadOptions(NamedTuple):
    """Arguments of `read_drive` that formats use."""

    map_srid: int | None = None
    headers_only: bool = False
    images_folder: Path | None = None


class DriveFormat(Protocol):
    """A format is a module with these names, listed in `FORMATS` of `readers/drives/__init__.py`."""

    NAME: str
    READS_OBJECTS: bool
    """Whether drives in object storage can be read, too."""

    def matches(self, path: Path) -> bool:
        """Whether a folder (or a file) looks like a drive of this format, complete or not."""

    def read(self, path: Path, options: ReadOptions) -> tuple[Drive, list[Rejection]]:
        """The drive and its rejections. Raises DriveFolderError or CalibrationError where there is no usable pair."""

    def read_header(self, path: Path, settings: DriveYaml, header: HeaderFacts) -> None:
        """Fill in the header without opening images. Raises the error that makes the drive unusable, after what is known."""


@dataclass
class HeaderFacts:
    """What `read_header` of a format finds, and the hash of the small files and names that identify the drive."""

    content: ContentHash = field(default_factory=ContentHash)
    streams: Sequence[str] = ()
    """What holds the left and the right images, for messages."""
    frame_pairs: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    def add_file(self, folder: Path, name: str) -> None:
        """A small file, where it exists."""
        if (folder / name).is_file():
            self.content.add(name, (folder / name).read_bytes())

    def add_images(self, folder: Path, sides: Mapping[str, Path]) -> None:
        """Names of all images and sizes of some, given the image folder of each side by its name. Raises DriveFolderError."""
        self.streams = [*sides]
        stems: set[str] = set()
        for side, data in sides.items():
            if not data.is_dir():
                raise DriveFolderError(f"{folder}: the folder {side} is missing")
            names = names_in(data, IMAGE_SUFFIXES)
            sizes = [f"{name} {(data / name).stat().st_size}" for name in every_nth(names, SAMPLED_IMAGES)]
            self.content.add(side, "\n".join([*names, *sizes]).encode(errors="surrogateescape"))
            stems |= {name.rsplit(".", 1)[0] for name in names}
        self.frame_pairs = len(stems)

    def add_samples(self, folder: Path, name: str) -> None:
        """Size and some pieces of a trajectory, which may be too long to read for a plan."""
        path = folder / name
        if not path.is_file():
            return
        size = path.stat().st_size
        pieces = [f"{size}\n".encode()]
        with path.open("rb") as file:
            for start in range(0, size, max(_SAMPLED_BYTES, (size - _SAMPLED_BYTES) // (SAMPLED_POSES - 1))):
                file.seek(start)
                pieces.append(file.read(_SAMPLED_BYTES))
        self.content.add(name, b"".join(pieces))

    def set_times(self, stamps_ns: Sequence[int | str], path: Path) -> None:
        """First and last time that the reader accepts; texts are stamps that cannot be read. Raises DriveFolderError."""
        stamps = [stamp for stamp in stamps_ns if isinstance(stamp, int)]
        wrong = misplaced(dict(enumerate(stamps)))
        good = [stamp for number, stamp in enumerate(stamps) if number not in wrong]
        if not good:
            raise DriveFolderError(f"{path}: there is no readable time stamp from 2000 or later")
        self.first_ns, self.last_ns = good[0], good[-1]


def names_in(data: Path, suffixes: Collection[str]) -> list[str]:
    """Sorted names of the files with one of these suffixes, without hidden ones."""
    with nullcontext(data.iterdir()) if is_remote(data) else os.scandir(data) as entries:
        found = (entry.name for entry in entries if not entry.name.startswith("."))
        return sorted(name for name in found if os.path.splitext(name)[1].lower() in suffixes)  # noqa: PTH122 -- many


def image_files(data: Path) -> list[Path]:
    """Sorted paths of the images in a folder, without hidden files."""
    return [p for p in sorted(data.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith(".")]


def every_nth(names: Sequence[str], count: int) -> Sequence[str]:
    """About `count` names, evenly distributed."""
    return names[:: max(1, len(names) // count)]


def drive_of_pairs(
    pairs: Sequence[FramePair],
    rejections: list[Rejection],
    expected: int,
    *,
    source: Path,
    settings: DriveYaml,
    rig: Rig,
    srid: int,
    content: ContentHash,
) -> tuple[Drive, list[Rejection]]:
    """The drive with its rejections. Raises DriveFolderError where no pair is left."""
    require_pairs(pairs, rejections, expected, source)
    drive = Drive(
        drive_id=settings.id_of(source), source_path=str(source), rig=rig, map_srid=srid,
        content_sha256=content.hexdigest(), frame_pairs=tuple(pairs), expected_frame_count=expected,
    )  # fmt: skip
    return drive, rejections
