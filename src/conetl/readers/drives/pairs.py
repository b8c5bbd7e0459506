"""What all drive readers do with frame pairs: hash and judge images, make rejections of bad pairs and a drive of the others."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from conetl.files.storage import fetch, remember
from conetl.geometry.rectification import stored_camera
from conetl.model.errors import DriveFolderError
from conetl.model.records import Drive, FramePair, Pose, Rig, Side
from conetl.model.rejections import Rejection, RejectionReason
from conetl.perception.image_headers import inspect_image
from conetl.perception.images import ImageFileError, check_image_bytes, check_image_ends, read_bytes
from conetl.readers.drives.drive_yaml import DriveYaml

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})


class ContentHash:
    """Hash of everything that was read of a drive: equal content has an equal hash, wherever the folder is, in any order."""

    def __init__(self, *, headers_only: bool = False) -> None:
        """headers_only: only the first and last bytes of images are checked, and images are not part of the hash."""
        self.headers_only = headers_only
        self.read_ahead: dict[Path, bytes] = {}
        """Images that were read before their turn, for their size."""
        self._files: dict[str, bytes] = {}

    def add(self, name: str, data: bytes) -> str:
        """Add one file that was read; its SHA-256. Names are posix paths relative to the drive folder."""
        found = hashlib.sha256(data)
        self._files[name] = found.digest()
        return found.hexdigest()

    def hexdigest(self) -> str:
        """SHA-256 over sorted names and the hashes of their bytes."""
        total = hashlib.sha256()
        for name in sorted(self._files):
            total.update(name.encode() + b"\0" + self._files[name])
        return total.hexdigest()


class ImageFile(NamedTuple):
    """One image of a drive."""

    path: Path
    sha256: str
    """Of its bytes; empty where only its header was read."""


class PairError(Exception):
    """Why one frame pair cannot be used."""

    def __init__(self, reason: RejectionReason, detail: str, **payload: Any) -> None:
        super().__init__(detail)
        self.reason, self.payload = reason, payload

    def rejection(self, record: str, frame_index: int) -> Rejection:
        """The rejection of the pair."""
        return Rejection(
            step="frames", reason=self.reason, record=record, detail=str(self),
            payload={"frame_index": frame_index, **self.payload},
        )  # fmt: skip


_Key = TypeVar("_Key", int, str)
_PAIRS_AT_ONCE = 8


def images_ahead(
    keys: Sequence[_Key],
    left: Mapping[_Key, Sequence[Path]],
    right: Mapping[_Key, Sequence[Path]],
    content: ContentHash,
) -> Iterator[_Key]:
    """The same keys of frame pairs; their images in object storage are asked for some pairs at a time."""
    for first in range(0, len(keys), _PAIRS_AT_ONCE):
        batch = keys[first : first + _PAIRS_AT_ONCE]
        if not content.headers_only:
            fetch([path for side in (left, right) for key in batch for path in side.get(key, ())], fresh=True)
        yield from batch


def check_images(
    left: Sequence[Path], right: Sequence[Path], rig: Rig, content: ContentHash, root: Path
) -> tuple[ImageFile, ImageFile]:
    """Both images of a pair, given all files that claim to be them.

    Header, size (of the images as stored: raw, where the rig was rectified) and end marker are checked, nothing is decoded.
    Both are read (for the content hash) before either is judged, and their bytes stay in memory for the steps to come.
    Raises PairError.
    """
    problem: PairError | None = None
    good: list[ImageFile] = []
    sides: tuple[tuple[Side, Sequence[Path]], ...] = (("left", left), ("right", right))
    for side, paths in sides:
        camera = stored_camera(rig, side)
        if len(paths) != 1:
            names = ", ".join(path.name for path in paths)
            reason = RejectionReason.IMAGE_UNREADABLE if paths else RejectionReason.IMAGE_MISSING
            detail = (
                f"several {side} images claim this pair: {names}; keep one" if paths else f"there is no {side} image"
            )
            problem = problem or PairError(reason, detail, side=side)
            continue
        name, sha256 = paths[0].relative_to(root).as_posix(), ""
        try:
            if content.headers_only:
                check_image_ends(paths[0], name, (camera.width_px, camera.height_px))
            else:
                data = content.read_ahead.pop(paths[0], None) or read_bytes(paths[0])
                sha256 = content.add(name, data)
                remember(paths[0], sha256, data)
                check_image_bytes(data, name, (camera.width_px, camera.height_px))
        except ImageFileError as error:
            problem = problem or PairError(error.reason, str(error), side=side, path=name)
        good.append(ImageFile(paths[0], sha256))
    if problem is not None:
        raise problem
    return good[0], good[1]


def first_size(paths: Iterable[Path], content: ContentHash | None = None) -> tuple[int, int] | None:
    """Width and height of the first image whose header can be read; None where there is none.

    content: of the drive that is read; its image need not be read again.
    """
    for path in paths:
        try:
            data = read_bytes(path)
            header = inspect_image(data)
        except (ImageFileError, ValueError):
            continue
        if content is not None:
            content.read_ahead[path] = data
        return header.width_px, header.height_px
    return None


#: Left and right image, time (UTC nanoseconds) and pose of the body of one frame pair.
UsablePair = tuple[ImageFile, ImageFile, int, Pose]


def drive_of_pairs(
    usable: Mapping[int, UsablePair],
    rejections: list[Rejection],
    expected: int,
    *,
    source: Path,
    settings: DriveYaml,
    rig: Rig,
    srid: int,
    content: ContentHash,
) -> tuple[Drive, list[Rejection]]:
    """The drive of the usable pairs by frame_index, with its rejections. Raises DriveFolderError where no pair is left."""
    if not usable:
        first = f"; the first: {rejections[0].record}: {rejections[0].detail}" if rejections else ""
        raise DriveFolderError(f"{source}: not one of {expected} frame pairs can be used{first}")
    pairs = tuple(
        FramePair(
            frame_index=number, left_path=str(left.path), right_path=str(right.path), captured_at_ns=captured, pose=pose,
            left_sha256=left.sha256, right_sha256=right.sha256,
        )
        for number, (left, right, captured, pose) in usable.items()
    )  # fmt: skip
    drive = Drive(
        drive_id=settings.id_of(source), source_path=str(source), rig=rig, map_srid=srid,
        content_sha256=content.hexdigest(), frame_pairs=pairs, expected_frame_count=expected,
    )  # fmt: skip
    return drive, rejections
