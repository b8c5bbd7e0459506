"""The interface of a drive format, and what all formats share: headers, and the rig on the body of the trajectory."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from conetl.files.documents import input_errors, read_bytes, read_table_bytes
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.geodesy import sensor_R_body
from conetl.geometry.motion.rolling_shutter import shutter_of, with_shutters
from conetl.model.arrays import Floats
from conetl.model.drive import Drive
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection
from conetl.model.rig import SIDES, Rig, Shutter
from conetl.readers.drives.camera_files import Files
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, ShutterSettings, small_file
from conetl.readers.drives.pairs import ContentHash, Source
from conetl.readers.rigs import RIG_YAML, read_rig_yaml
from conetl.readers.rigs.common import Pair, rectified_rig
from conetl.readers.trajectories.times import misplaced

#: Images per side whose size is part of the header: a drive that is copied again with other images is another drive.
#: And pose files, or pieces of a trajectory: corrected poses often have as many digits.
_SAMPLES = 16
_SAMPLED_BYTES = 4096
T = TypeVar("T")


class DriveFormat(Protocol):
    """A format is a module with these names, listed in `FORMATS` of `readers/drives/__init__.py`."""

    NAME: str
    TITLE: str
    """For people, as `conetl inspect` prints it."""
    READS_OBJECTS: bool
    """Whether drives in object storage can be read, too."""
    UNPACKS: bool
    """Whether images must be unpacked to files before they can be read."""

    def matches(self, path: Path) -> bool:
        """Whether a folder (or a file) looks like a drive of this format, complete or not."""

    def scan(self, path: Path, settings: DriveYaml) -> Files:
        """The files of a drive, by their names. Raises InputError where there can be none."""

    def read(self, source: Source) -> tuple[Drive, list[Rejection]]:
        """The drive and its rejections. Raises InputError where there is no usable pair."""

    def read_header(self, source: Source, header: HeaderFacts) -> None:
        """Add the times to the header, without opening images. Raises the error that makes the drive unusable."""


@dataclass
class HeaderFacts:
    """The result of `read_header` of a format, and the hash of the small files and names that identify the drive."""

    content: ContentHash = field(default_factory=ContentHash)
    frame_pairs: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    remarks: list[str] = field(default_factory=list)
    """What the user of the drive has to know, although it can be read."""

    def add(self, files: Files) -> None:
        """The names of all images and sizes of some, small files, and pieces of the others."""
        self.frame_pairs = files.image_count
        for stream in (files.left, files.right):
            if stream.paths and not stream.is_video:
                # A broken link has no size: only its frame pair is lost.
                known = ((path, path.stat().st_size if path.exists() else None) for path in samples_of(stream.paths))
                sizes = [f"{path.name} {size}" for path, size in known]
                names = [path.name for path in stream.paths]
                self.content.add(stream.name, "\n".join([*names, *sizes]).encode(errors="surrogateescape"))
        for name, inner in files.listed.items():
            self.content.add(name, "\n".join(inner).encode(errors="surrogateescape"))
        for name, path in files.small.items():
            if path.is_file():
                self.content.add(name, read_table_bytes(path))
        for name, path in files.logs.items():
            if path.is_file():
                self.content.add(name, _pieces_of(path))

    def set_times(self, stamps_ns: Collection[int | str], path: Path) -> None:
        """First and last time that the reader accepts; texts are stamps that cannot be read. Raises InputError."""
        stamps = [stamp for stamp in stamps_ns if isinstance(stamp, int)]
        wrong = misplaced(dict(enumerate(stamps)))
        good = [stamp for number, stamp in enumerate(stamps) if number not in wrong]
        if not good:
            raise InputError(f"{path}: there is no readable time stamp between 2000 and today")
        self.first_ns, self.last_ns = good[0], good[-1]


def _pieces_of(path: Path) -> bytes:
    """Size and some pieces of a file."""
    size = path.stat().st_size
    step = max(_SAMPLED_BYTES, (size - _SAMPLED_BYTES) // (_SAMPLES - 1))
    with path.open("rb") as file:
        return f"{size}\n".encode() + b"".join(
            os.pread(file.fileno(), _SAMPLED_BYTES, at) for at in range(0, size, step)
        )


def samples_of(names: Sequence[T]) -> Sequence[T]:
    """About 16 of the names, evenly distributed."""
    return names[:: max(1, len(names) // _SAMPLES)]


def rig_on_body(rig: Rig, sensor_SE3_left: Floats, settings: DriveYaml, source: Path) -> tuple[Rig, Floats]:
    """The rectified rig, and sensor_R_body (3, 3): the body is the sensor with its axes renamed to forward, left, up.

    rig: only its cameras and their relative pose are used. sensor_SE3_left (4, 4): from points of the left camera to points of
    the sensor whose trajectory was recorded. Raises InputError.
    """
    turn = sensor_R_body(sensor_SE3_left[:3, :3])
    body_SE3_left = se3.compose(se3.se3(turn.T, np.zeros(3)), sensor_SE3_left)
    body_SE3_right = se3.compose(body_SE3_left, rigs.left_SE3_right(rig))
    poses = {"body_SE3_left": se3.to_matrix4(body_SE3_left), "body_SE3_right": se3.to_matrix4(body_SE3_right)}
    with input_errors(source):
        on_body = Rig.model_validate(dict(rig) | poses | overrides(settings))
    return rectified_rig(on_body, source), turn


def overrides(settings: DriveYaml) -> dict[str, object]:
    """Fields of the rig that drive.yaml overrides."""
    changes: dict[str, object] = {"rig_id": settings.rig_id} if settings.rig_id else {}
    return changes | ({"sigma_px": settings.sigmas.image_px} if "image_px" in settings.sigmas.model_fields_set else {})


def with_stated_shutters(rig: Rig, settings: ShutterSettings) -> Rig:
    """The rig with the shutters of its cameras as drive.yaml states them. Raises InputError for a sigma without a readout."""
    both = settings.model_dump(exclude_none=True, exclude={"right"})
    own = {"left": both, "right": both | settings.right.model_dump(exclude_none=True)}
    if not any(own.values()):
        return rig
    found: dict[str, Shutter | None] = {}
    for side in SIDES:
        known = shutter_of(rig, side)
        values = ({} if known is None else known.model_dump()) | own[side]
        if values and "readout_ms" not in values:
            raise InputError(f"{DRIVE_YAML}: 'shutter' needs readout_ms, of which the other keys are details")
        found[side] = Shutter.model_validate(values) if values else None
    return with_shutters(rig, found["left"], found["right"])


def own_rig(path: Path, pair: Pair | None) -> tuple[Rig, Floats] | None:
    """Rig of a rig.yaml beside the recording, which overrides the recording's own calibration, and its body_SE3_left.

    pair: of its cameras, where it has more than two.

    None without the file. Raises InputError where the file has no pose of the left camera on the body.
    """
    if not path.is_file():
        return None
    rig = read_rig_yaml(path, pair=pair)
    if rigs.body_is_left_camera(rig):
        raise InputError(
            f"{path}: 'body_SE3_left' is missing: R and t_m, from points of the left camera to points of the body whose "
            "trajectory was recorded"
        )
    return rig, rigs.body_SE3_camera(rig, "left")


def no_rig(folder: Path) -> InputError:
    """The error for a drive without `rig.yaml`, if its format has no other calibration."""
    return InputError(
        f"{folder}: {RIG_YAML} is missing: 'conetl init {folder}' writes it from the calibration of another program, "
        "'conetl calibrate' from images of a board"
    )


def add_settings(content: ContentHash, source: Path, names: tuple[str, ...] = (RIG_YAML, DRIVE_YAML)) -> None:
    """Add the small files of a drive to its content hash, under their usual names."""
    for name in names:
        path = small_file(source, name)
        if path.is_file():
            content.add(name, read_bytes(path))
