"""`conetl init`: make a drive of a folder with stereo video or images and a trajectory file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from conetl.cli.console import JsonOption, MapSridOption, print_json, say
from conetl.files.atomic import write_text
from conetl.geometry import rig as rigs
from conetl.model.errors import EXIT_NEEDS_ATTENTION, CalibrationError, DriveFolderError, InputError
from conetl.perception.video import VIDEO_SUFFIXES, video_facts
from conetl.readers.drives import find_format, read_drive
from conetl.readers.drives.drive_yaml import DRIVE_YAML, DriveYaml
from conetl.readers.drives.formats import names_in
from conetl.readers.drives.summary import summarise
from conetl.readers.rigs import FORMAT_NAMES, RIG_YAML, read_rig_and_format, write_rig_yaml
from conetl.readers.trajectories import find_trajectories, read_trajectory, trajectory_format
