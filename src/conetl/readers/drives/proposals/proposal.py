"""What `conetl init` knows of a folder so far."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from conetl.model.rig import Rig
from conetl.readers.drives.proposals.template import Missing
from conetl.readers.trajectories.recorded import RecordedTrajectory

#: Keys that name a file or folder of the drive.
FILE_KEYS = (
    "images.left",
    "images.right",
    "images.timestamps",
    "images.right_timestamps",
    "trajectory.file",
    "control_points.file",
)
#: Suffixes of tables and of files of times.
TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".txt"})


class Proposal(NamedTuple):
    """What was found in a folder, what is missing, and the settings so far."""

    found: list[str]
    missing: list[Missing]
    settings: dict[str, Any]
    """Content of drive.yaml."""
    rig: Rig | None
    """To be written as rig.yaml; None where there is one."""
    recorded: RecordedTrajectory | None
    """The trajectory, where it can be read."""


def value_at(settings: Mapping[str, Any], key: str) -> Any:
    """The value of a key like `images.left`; None where there is none."""
    section, _, name = key.partition(".")
    values = settings.get(section)
    return values.get(name) if isinstance(values, Mapping) else None
