"""Factory calibration of a ZED camera: `SNxxxx.conf`, an INI file with one calibration per resolution, lengths in millimetres.

Pixels and lenses are OpenCV's. The pose is that of Stereolabs' own calibration tool (zed-opencv-calibration), which writes the
result of `cv2.stereoCalibrate`: `p_right = R p_left + t` with the rotation vector (RX, CV, RZ) and t = (-Baseline, TY, TZ). Older
programs negate TY and TZ, which the file cannot decide: they are tenths of a millimetre, and a millimetre of TY at 120 mm is half
a degree of tilt. `conetl inspect` shows rows that do not fit.
"""

from __future__ import annotations

from configparser import Error, RawConfigParser
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from conetl.files.documents import MAX_SHOWN, read_limited, shown
from conetl.geometry import pose as se3
from conetl.model.errors import CalibrationError
from conetl.model.records import MIN_BASELINE_M, Camera, Lens, Rig
from conetl.readers.rigs.common import LENGTH_UNITS, Size, bad, camera_from_matrix, numbers_at, opencv_lens, stereo_rig

#: Size of one camera's image by the name of the resolution.
RESOLUTIONS: dict[str, Size] = {
    "4K": (3840, 2160), "2K": (2208, 1242), "FHD1200": (1920, 1200), "FHD": (1920, 1080), "HD": (1280, 720), "SVGA": (960, 600),
    "VGA": (672, 376),
}  # fmt: skip
_POLYNOMIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
Sections = dict[str, dict[str, str]]


def read_zed_rig(path: Path, *, image_size: Size | None = None) -> Rig:
    """Raw rig of one resolution; image_size: width and height of one camera's image, where the file has several.

    Raises CalibrationError.
    """
    sections = _sections(path)
    name = _resolution(path, sections, image_size)
    left, right = (_camera(path, sections, side, name) for side in ("LEFT", "RIGHT"))
    stereo = sections.get("STEREO", {})
    baseline, ty, tz = (
        numbers_at(path, {key: "0"} | stereo if key != "baseline" else stereo, key, (1,), "STEREO.")[0]
        for key in ("baseline", "ty", "tz")
    )
    turn = [numbers_at(path, stereo, f"{key}_{name.lower()}", (1,), "STEREO.")[0] for key in ("rx", "cv", "rz")]
    key = "STEREO.Baseline"
    if not baseline * LENGTH_UNITS["mm"] >= MIN_BASELINE_M:
        raise bad(path, key, f"must be {MIN_BASELINE_M / LENGTH_UNITS['mm']:g} millimetres or more, found {baseline:g}")
    if not np.linalg.norm(turn) < np.pi / 4:
        raise bad(
            path, f"STEREO.RX_{name}, CV_{name}, RZ_{name}", f"must be small angles in radians, found {shown(turn)}"
        )
    shift_m = LENGTH_UNITS["mm"] * np.array([-baseline, ty, tz])
    return stereo_rig(path, key, "zed", left, right, se3.se3(Rotation.from_rotvec(turn).as_matrix(), shift_m))


def _sections(path: Path) -> Sections:
    """Values by section (in capitals) and key (in lower case)."""
    parser = RawConfigParser(inline_comment_prefixes=("#", ";"))
    try:
        parser.read_string(read_limited(path), source=path.name[:MAX_SHOWN])
    except Error as error:
        raise CalibrationError(f"{path}: this is no INI file: {' '.join(str(error).split())[:MAX_SHOWN]}") from error
    return {name.upper(): dict(parser.items(name)) for name in parser.sections()}


def _resolution(path: Path, sections: Sections, image_size: Size | None) -> str:
    """Name of the resolution that is meant."""
    known = [name for name in RESOLUTIONS if f"LEFT_CAM_{name}" in sections and f"RIGHT_CAM_{name}" in sections]
    if not known:
        raise CalibrationError(
            f"{path}: expected the sections LEFT_CAM_HD and RIGHT_CAM_HD (or {', '.join(RESOLUTIONS)}) of a ZED camera, found "
            f"{shown([*sections])}"
        )
    fitting = [name for name in known if image_size in (None, RESOLUTIONS[name])]
    if len(fitting) == 1:
        return fitting[0]
    sizes = ", ".join(f"{RESOLUTIONS[name][0]}x{RESOLUTIONS[name][1]} ({name})" for name in known)
    given = "" if image_size is None else f", none is {image_size[0]}x{image_size[1]}"
    raise CalibrationError(
        f"{path}: the file has calibrations for images of {sizes}{given}; name that of your images: conetl rig convert with "
        "--image-size (one camera's image, half of a side-by-side one)"
    )


def _camera(path: Path, sections: Sections, side: str, name: str) -> Camera:
    where = f"{side}_CAM_{name}"
    fx, fy, cx, cy = (numbers_at(path, sections[where], key, (1,), f"{where}.")[0] for key in ("fx", "fy", "cx", "cy"))
    k = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return camera_from_matrix(path, where, k, RESOLUTIONS[name], _lens(path, sections, side, where))


def _lens(path: Path, sections: Sections, side: str, where: str) -> Lens:
    """Coefficients beside the camera matrix, or (files of newer cameras) in a section for all resolutions."""
    found = [part for part in (where, f"{side}_DISTO") if "k1" in sections.get(part, {})]
    if len(found) != 1:
        raise bad(
            path, f"{where}.k1", f"must be in one of {where} and {side}_DISTO, found in {' and '.join(found) or 'none'}"
        )
    part = found[0]
    given = sections[part]
    if "k4" in given and "p1" not in given:
        raise bad(
            path, f"{part}.k4", "without p1 and p2 is a fisheye lens, whose meaning in ZED files conetl does not know"
        )
    # k3 to k6 and the tangential coefficients are zero where a file does not have them.
    values = [numbers_at(path, {key: "0"} | given, key, (1,), f"{part}.")[0] for key in _POLYNOMIAL]
    return opencv_lens(path, f"{part}.k1 to k6", values)
