"""The header of a drive: when it was recorded, how many images, which drive it is. No image is opened.

For plans over many drives. The header identifies a drive; its exact content is compared when it is ingested.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from conetl.files.names import printable, require_utf8
from conetl.files.storage import is_remote
from conetl.model.base import utc_from_ns
from conetl.model.errors import ConetlError, InputError, ServiceError, is_storage_error
from conetl.readers.drives import OpenDrive, find_format, kitti
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml, inside, read_drive_yaml
from conetl.readers.drives.formats import HeaderFacts, add_settings
from conetl.readers.drives.pairs import ContentHash, Source, no_images


@dataclass(frozen=True)
class DriveHeader:
    """Facts about a drive folder that are known without opening its images."""

    path: Path
    drive_id: str
    header_sha256: str
    frame_pairs: int
    captured_from_ns: int | None
    captured_to_ns: int | None
    """UTC; None where the times are unknown: then `problem` is the reason, or the clock of a bag's recorder was not set."""
    problem: str | None
    problem_may_pass: bool = False
    """The storage failed, which is not a property of the drive."""
    remarks: tuple[str, ...] = ()
    """What the user has to know, although the drive can be read."""

    @property
    def shown_path(self) -> str:
        """The path as text that can be printed and stored, whatever bytes its names have."""
        return printable(self.path)

    @property
    def captured_from(self) -> datetime | None:
        return None if self.captured_from_ns is None else utc_from_ns(self.captured_from_ns)


def remarks_of(opened: OpenDrive) -> tuple[str, ...]:
    """The remarks of a drive that can be read, as of its header."""
    facts = HeaderFacts()
    with suppress(InputError):
        opened.format.read_header(opened.source._replace(content=ContentHash()), facts)
    return tuple(printable(remark) for remark in facts.remarks)


def read_header(folder: Path) -> DriveHeader:
    """The header of a drive folder or a bare bag. Raises nothing: `problem` states what is wrong with the drive."""
    facts = HeaderFacts()
    drive_id = printable(folder.name)[:200] or "drive"
    problem = found = None
    readable, passes = True, False
    try:
        drive_id = DriveYaml().id_of(folder)
        facts.content.add("drive_id", drive_id.encode())
        add_settings(facts.content, folder, (DRIVE_YAML,))
        settings = read_drive_yaml(folder)
        drive_id = settings.id_of(folder)
        if settings.control_points is not None and folder.is_dir():
            path = inside(folder, settings.control_points.file, DRIVE_YAML)
            if path.is_file():
                facts.content.add_file(settings.control_points.file, path)
        facts.content.add("drive_id", drive_id.encode())
        if not is_remote(folder):
            require_utf8(folder)
        found = find_format(folder)
        if found is None and not is_remote(folder) and not folder.is_file():
            with os.scandir(folder):
                pass  # raises OSError where it cannot be listed: then it may hold a drive
        files = (found or kitti).scan(folder, settings)
        facts.add(files)
        source = Source(folder, folder.resolve(), settings, ContentHash(), settings.map_srid, None, files)
        (found or kitti).read_header(source, facts)
        if not facts.frame_pairs:
            problem = f"{no_images(folder, files.left.name, files.right.name)}"
    except OSError as error:
        problem = f"this cannot be read: {error.strerror or error}: {error.filename or folder}"
        readable = False
        passes = is_storage_error(error)
    except (ConetlError, ValueError) as error:
        problem = f"{error}"
        passes = is_storage_error(error.__cause__) or isinstance(error, ServiceError)
    except Exception as error:  # a foreign file must not stop the plan of a year
        problem = f"this cannot be read: {type(error).__name__}: {error}"
        readable = False
    if found is None or not readable:
        facts.content.add("path", printable(folder).encode())  # nothing else distinguishes it from others
    return DriveHeader(
        folder, drive_id, facts.content.hexdigest(), facts.frame_pairs, facts.first_ns, facts.last_ns,
        None if problem is None else printable(problem), passes, tuple(printable(remark) for remark in facts.remarks),
    )  # fmt: skip
