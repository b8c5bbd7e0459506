"""The calibration of a folder for `conetl init`, and the mount of the cameras."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from conetl.files.documents import input_errors
from conetl.geometry import rig as rigs
from conetl.model.rig import Rig
from conetl.readers.drives import pose_rows
from conetl.readers.drives.camera_files import names_in
from conetl.readers.drives.drive_yaml import DRIVE_YAML, Mount
from conetl.readers.drives.proposals.template import RIG, Proposal, value_at
from conetl.readers.rigs import RIG_SUFFIXES, RIG_YAML, FoundRigs, find_rigs, read_given_rig


def add_rig(root: Path, rig_file: Path | None, proposal: Proposal, size: tuple[int, int] | None) -> Rig | None:
    """The rig that has to be written; None where it is there, or is not known yet."""
    if rig_file is not None:
        path = rig_file
        rig, kind = read_given_rig(path, size)
    else:
        found, of_other_size, unread = _fitting(root, size, proposal.settings["images"])
        proposal.found.extend(of_other_size)
        if unread and not found and size is None and proposal.missing:
            return None  # one may fit once the size of the images is known
        if not found:
            proposal.found.extend(unread)
        replaces = (root / RIG_YAML).is_file() and RIG_YAML not in (path.name for path, _, _ in found)
        # A file that somebody made is not replaced without being asked.
        if len({_numbers_of(rig) for _, rig, _ in found}) != 1 or replaces:
            names = ", ".join(path.name for path, _, _ in found) or "none that fits"
            cause = f"Found: {names}."
            if not found:
                cause += " 'conetl calibrate' makes one from images of a board."
            if not found and of_other_size and "crop" not in proposal.settings["images"]:
                cause += " If these images are a part of larger ones, or were padded or binned, state images.crop."
            proposal.need(RIG, cause + f" It replaces {RIG_YAML}." * replaces)
            return None
        path, rig, kind = found[0]
    image_size = f"{rig.left.width_px} x {rig.left.height_px}"
    proposal.found.append(f"calibration {path.name} ({kind}): {image_size}, baseline {rig.baseline_m:.3f} m")
    if "mount" in proposal.settings:
        proposal.found.append(_mounted(Mount.model_validate(proposal.settings["mount"])))
    elif rigs.body_is_left_camera(rig):
        log = value_at(proposal.settings, "trajectory.file")
        if log is None or not pose_rows.looks_like(root / log):  # else the poses are those of the left camera
            proposal.need("mount")
    return None if path == root / RIG_YAML else rig


def _fitting(root: Path, size: tuple[int, int] | None, images: Mapping[str, Any]) -> FoundRigs:
    """The calibrations for images of this size, or for larger ones of which these are the stated part."""
    if images.get("crop") is None:
        return rigs_in(root, size)
    found = rigs_in(root, None)
    part = FoundRigs([], [*found.of_other_size], found.unread)
    for path, rig, kind in found.fitting:
        with input_errors(f"{path}: images.crop"):
            camera = rigs.cropped(rig, *images["crop"], binning=images.get("binning", 1)).left
        if size in (None, (camera.width_px, camera.height_px)):
            part.fitting.append((path, rig, kind))
        else:
            part.of_other_size.append(
                f"calibration {path.name}: the stated part of its images has {camera.width_px} x {camera.height_px} pixels, "
                f"these images have {size[0]} x {size[1]}"
            )
    return part


def _numbers_of(rig: Rig) -> tuple[object, ...]:
    """What is equal in two files of one calibration."""
    cameras = (
        (c.width_px, c.height_px, round(c.fx_px, 3), round(c.cx_px, 3), round(c.cy_px, 3))
        for c in (rig.left, rig.right)
    )
    return *cameras, round(rig.baseline_m, 4)


def rigs_in(root: Path, size: tuple[int, int] | None) -> FoundRigs:
    """The calibrations in a folder for images of a size."""
    return find_rigs([root / name for name in names_in(root, RIG_SUFFIXES) if name != DRIVE_YAML], size)


def _mounted(mount: Mount) -> str:
    """A mount in words: a sign the wrong way round is seen there."""
    forward, left, up, pitch = mount.forward_m, mount.left_m, mount.up_m, mount.pitch_deg
    along, aside = "in front of" if forward >= 0 else "behind", "left of" if left >= 0 else "right of"
    over = "above" if up >= 0 else "below"
    place = f"{abs(forward):g} m {along}, {abs(left):g} m {aside} and {abs(up):g} m {over} the antenna or IMU"
    turned = f", yaw {mount.yaw_deg:g}, roll {mount.roll_deg:g} degrees" if mount.yaw_deg or mount.roll_deg else ""
    unstated = "" if "pitch_deg" in mount.model_fields_set else ", as no pitch is stated"
    return f"left camera: {place}, looks {abs(pitch):g} degrees {'down' if pitch >= 0 else 'up'}{turned}{unstated}"
