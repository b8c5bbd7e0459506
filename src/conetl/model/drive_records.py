"""All that the steps made of one drive, as it travels to the map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from conetl.model.records import Detection, Drive, Position, StereoMatch, Track
from conetl.model.rejections import Rejection


class DriveRecords(NamedTuple):
    """One drive and the records of every step, in the order in which data flows."""

    drive: Drive
    """With the refined poses and the turned right camera, where trajectory and calibration were refined."""
    detections: Sequence[Detection] = ()
    matches: Sequence[StereoMatch] = ()
    positions: Sequence[Position] = ()
    tracks: Sequence[Track] = ()
    rejections: Sequence[Rejection] = ()
