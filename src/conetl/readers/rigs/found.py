"""The calibrations among the files of a folder, for `conetl init`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from conetl.model.errors import CalibrationError
from conetl.model.rig import Camera, Rig
from conetl.readers.rigs import FORMAT_NAMES, RIG_YAML, read_rig_and_format

RIG_SUFFIXES = frozenset({".yaml", ".yml", ".xml", ".json", ".conf", ".mat"})
_LARGEST_BYTES = 4_000_000
#: How far a principal point is from the centre of its image, at most, in parts of the image's size.
_OFF_CENTRE = 0.2
#: Baselines that a file without a unit may mean in millimetres (m).
_MILLIMETRES_M = (0.1, 2.0)


class FoundRigs(NamedTuple):
    """What `find_rigs` found; reasons are sentences that name the file."""

    fitting: list[tuple[Path, Rig, str]]
    """With their formats in words."""
    of_other_size: list[str]
    unread: list[str]


def find_rigs(paths: Sequence[Path], size: tuple[int, int] | None) -> FoundRigs:
    """The calibrations for images of this size (width, height): rig.yaml, or if there is none that fits, those of other tools.

    paths: files of one folder, with one of `RIG_SUFFIXES`. Raises CalibrationError for a rig.yaml that cannot be read.
    """
    found = FoundRigs([], [], [])
    for path in sorted(paths, key=lambda path: (path.name != RIG_YAML, path.name)):
        of_conetl = bool(found.fitting) and found.fitting[0][0].name == RIG_YAML
        if of_conetl or path.stat().st_size > _LARGEST_BYTES:
            continue
        try:
            rig, kind = read_given_rig(path, size)
        except CalibrationError as error:
            if path.name == RIG_YAML:
                raise
            found.unread.append(f"{path.name} is not used as a calibration: {str(error).removeprefix(f'{path}: ')}")
            continue
        width_px, height_px = rig.left.width_px, rig.left.height_px
        if size is None or size == (width_px, height_px):
            found.fitting.append((path, rig, kind))
        else:
            found.of_other_size.append(
                f"calibration {path.name}: for images of {width_px} x {height_px}, these have {size[0]} x {size[1]}; 'conetl rig "
                "convert --scale-to' fits one to images that were scaled"
            )
    return found


def read_given_rig(path: Path, size: tuple[int, int] | None) -> tuple[Rig, str]:
    """A calibration, and its format in words. Raises CalibrationError.

    A file without an image size is one of images of this size, one without a unit whose baseline in metres is too long is in mm.
    """
    try:
        rig, kind = read_rig_and_format(path)
        return rig, FORMAT_NAMES[kind]
    except CalibrationError:
        shortest_m, longest_m = _MILLIMETRES_M
        for image_size, unit in ((size, None), (None, "mm"), (size, "mm")):
            with suppress(CalibrationError):
                rig, kind = read_rig_and_format(path, image_size=image_size, length_unit=unit)
                # With another size the principal point would not be near the centre.
                if _is_centred(rig.left) and _is_centred(rig.right):
                    if unit is None:
                        return rig, FORMAT_NAMES[kind]
                    if shortest_m <= rig.baseline_m <= longest_m:
                        return rig, f"{FORMAT_NAMES[kind]}, lengths taken as mm"
        raise


def _is_centred(camera: Camera) -> bool:
    x, y = camera.cx_px / camera.width_px, camera.cy_px / camera.height_px
    return max(abs(x - 0.5), abs(y - 0.5)) <= _OFF_CENTRE
