"""A folder with stereo video or images, a trajectory and a calibration -> settings that make it a drive, for `conetl init`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from conetl.perception.video import VIDEO_SUFFIXES
from conetl.readers.drives.proposals.images import add_images, check_start, stated_time, suggested
from conetl.readers.drives.proposals.log_and_rig import add_rig, add_trajectory
from conetl.readers.drives.proposals.template import FILE_KEYS, Proposal, value_at

__all__ = ["FILE_KEYS", "Proposal", "check_start", "propose", "stated_time", "still_valid", "suggested"]


def propose(root: Path, settings: Mapping[str, Any], rig_file: Path | None = None) -> Proposal:
    """The settings of a drive folder: those that are given, and what the folder shows.

    settings: valid ones of `DriveYaml`; rig_file: the calibration to use. Raises InputError where there is nothing to make a
    drive of, or a setting does not fit.
    """
    copied = {name: dict(value) if isinstance(value, Mapping) else value for name, value in settings.items()}
    proposal = Proposal([], [], copied)
    size = add_images(root, rig_file, proposal)
    recorded = add_trajectory(root, proposal)
    proposal.missing[:] = [suggested(root, proposal.settings, recorded, each) for each in proposal.missing]
    rig = add_rig(root, rig_file, proposal, size)
    return proposal._replace(rig=rig, recorded=recorded)


def still_valid(settings: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of an earlier drive.yaml without those that new ones make invalid."""

    def changes(*keys: str) -> bool:
        known = [(value_at(settings, key), value_at(given, key)) for key in keys]
        return any(new is not None and old not in (None, new) for old, new in known)

    kept = {section: dict(value) if isinstance(value, Mapping) else value for section, value in settings.items()}
    images, has_start = kept.get("images", {}), value_at(given, "images.start") is not None
    becomes_one = value_at(given, "images.layout") is not None and "right" in images
    if becomes_one or changes("images.left", "images.right", "images.layout"):
        kept["images"] = images = {key: value for key, value in images.items() if key in ("every", "from_s", "to_s")}
        kept.pop("clock", None)
    if changes("trajectory.file"):
        # The start was found with the other log, or noted by a clock like its own.
        if "clock" in kept:
            images.pop("start", None)
        kept = {section: value for section, value in kept.items() if section not in ("trajectory", "sigmas", "clock")}
    if has_start:
        kept.pop("clock", None)
    if has_start and Path(str(images.get("left"))).suffix.lower() in VIDEO_SUFFIXES:
        for key in ("timestamps", "right_timestamps"):
            images.pop(key, None)
    return kept
