"""A KITTI drive as two videos, or one with both images in each frame, with its trajectory as a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
import yaml

from conetl.geometry import geodesy
from conetl.model.drive import Drive
from conetl.perception.rectified_image import read_pair_image
from conetl.readers.rigs import write_rig_yaml
from tests.unit.readers import trajectory_files as logs
from tests.unit.readers.drive_formats import Frame
from tests.unit.readers.trajectory_files import Known, write_csv

#: Time stamps of the videos, in a second.
UNITS = 90_000


def _stated(codec: str, options: dict[str, str]) -> dict[str, str]:
    """The encoder's options, so that the file states where its samples of colour are: between two columns, as the library makes
    them of other formats. Without that H.264 and H.265 have them in every second column."""
    if codec not in ("libx264", "libx265"):
        return options
    key = f"{codec[3:]}-params"
    return {**options, key: ":".join(["chromaloc=1", *filter(None, [options.get(key)])])}


def write_frames(
    path: Path,
    images: Sequence[np.ndarray],
    times_ns: Sequence[int],
    codec: str,
    options: dict[str, str],
    units: int = UNITS,
) -> Path:
    """Images (H, W, 3), even in size, as a video whose time stamps begin with zero and have so many units in a second."""
    with av.open(str(path), "w", options={"fflags": "bitexact"}) as container:  # Matroska draws a number for each file
        stream = container.add_stream(codec, rate=10, options=_stated(codec, options))
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, units)
        for image, time_ns in zip(images, times_ns, strict=True):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            # Rounded down: the last frame is not after the last pose of a log that has one per frame.
            frame.pts, frame.time_base = (time_ns - times_ns[0]) * units // 10**9, Fraction(1, units)
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)
    return path


def write_video_drive(
    root: Path,
    drive: Drive,
    *,
    layout: str | None = None,
    codec: str = "libx264",
    options: dict[str, str] | None = None,
    suffix: str = ".mp4",
    trajectory: bool = True,
) -> Path:
    """The same drive as videos, a rig.yaml and a table of its poses; drive.yaml says when it began. Odd rows are left out."""
    root.mkdir(parents=True)
    height, width = drive.rig.left.height_px // 2 * 2, drive.rig.left.width_px // 2 * 2
    images = {
        side: [read_pair_image(pair, side, drive.rig)[:height, :width] for pair in drive.frame_pairs]
        for side in ("left", "right")
    }
    times = [pair.captured_at_ns for pair in drive.frame_pairs]
    options = options or {"crf": "18"}
    if layout is None:
        for side, frames in images.items():
            write_frames(root / f"{side}{suffix}", frames, times, codec, options)
    else:
        order = ("left", "right") if layout in ("left-right", "top-bottom") else ("right", "left")
        join = np.hstack if "left" in layout else np.vstack
        both = [join(pair) for pair in zip(*(images[side] for side in order), strict=True)]
        write_frames(root / f"both{suffix}", both, times, codec, options)
    cameras = {s: getattr(drive.rig, s).model_copy(update={"height_px": height, "width_px": width}) for s in images}
    write_rig_yaml(drive.rig.model_copy(update=cameras), root / "rig.yaml")
    seconds, rest = divmod(times[0], 10**9)
    start = f"{np.datetime64(seconds, 's')}".replace("T", " ") + f".{rest:09d}Z"
    layout_text = f", layout: {layout}" if layout else ", right_offset_s: 0"
    settings = (
        f"images: {{start: '{start}'{layout_text}}}\nshutter: {{readout_ms: 0}}\n"  # its cameras are simulated ones
    )
    (root / "drive.yaml").write_text(settings)
    if trajectory:
        write_csv(root, known_of(drive))
    return root


def known_of(drive: Drive) -> Known:
    """The poses of a drive, to be written as a trajectory file."""
    poses = [pair.pose for pair in drive.frame_pairs]
    llh = geodesy.to_geodetic(drive.map_srid, np.array([pose.map_t_body_m for pose in poses]))
    R = np.array([pose.map_R_body for pose in poses])
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0]) - geodesy.grid_convergence_rad(drive.map_srid, llh[:, 0], llh[:, 1])
    pitch_up, roll_right = np.arcsin(R[:, 2, 0]), np.arctan2(R[:, 2, 1], R[:, 2, 2])
    rph = np.column_stack([np.degrees(roll_right), np.degrees(pitch_up), (90 - np.degrees(yaw)) % 360])
    sigma = np.array([[*pose.sigma_enu_m, *np.degrees(pose.sigma_rpy_rad)] for pose in poses])
    times = np.array([pair.captured_at_ns for pair in drive.frame_pairs], dtype=np.int64)
    return Known(times, llh, rph, sigma)


def same_image(found: np.ndarray, true: np.ndarray) -> bool:
    return found.shape == true.shape and cv2.PSNR(found, true) > 27


# --------------------------------------------------------------------------- the same drive with other logs, as bags


class Log(NamedTuple):
    """How to write a trajectory, what its file does not say (keys of `trajectory`), and whether it has sigmas."""

    write: Callable[[Path, Known], Path]
    says: Callable[[Known], dict[str, Any]] = lambda _: {}
    has_sigma: bool = True


LOGS = {
    "SBET + smrmsg": Log(logs.write_sbet, lambda t: {"week": logs.gps_time(t)[0][0]}),
    "Inertial Explorer": Log(logs.write_inertial_explorer),
    "NMEA with PASHR": Log(logs.write_nmea),
    "CSV": Log(logs.write_csv),
    "CSV, German": Log(logs.write_german, lambda _: {"time": "Europe/Berlin"}),
    "TSV, projected": Log(logs.write_tsv, lambda _: {"crs": "EPSG:25832"}, has_sigma=False),
    "RTKLIB .pos": Log(logs.write_rtklib),
    "NMEA, positions": Log(partial(logs.write_nmea, attitude=False)),
    "GPX": Log(logs.write_gpx, has_sigma=False),
}


def with_log(videos: Path, root: Path, log: Log, t: Known, **more: Any) -> Path:
    """The same videos with another log, and more settings: those of `images` are added to what is there."""
    root.mkdir(parents=True)
    for path in videos.iterdir():
        if path.name != "drive.yaml":
            (root / path.name).hardlink_to(path)
    file = log.write(root, t)
    settings = yaml.safe_load((videos / "drive.yaml").read_text())
    settings["images"] |= more.pop("images", {})
    settings |= {"trajectory": {"file": file.name, **log.says(t)}, **more}
    if not log.has_sigma:
        horizontal, vertical = (float(np.median(t.sigma[:, k])) for k in (0, 2))
        settings["sigmas"] = {"horizontal_m": horizontal, "vertical_m": vertical}
    (root / "drive.yaml").write_text(yaml.safe_dump(settings))
    return root


def frames_of(drive: Drive) -> list[Frame]:
    """The image files of a drive with its poses, for bags."""
    t = known_of(drive)
    angles = np.radians(np.column_stack([t.rph[:, 0], -t.rph[:, 1], 90 - t.rph[:, 2]]))
    return [
        Frame(Path(pair.left_path).read_bytes(), Path(pair.right_path).read_bytes(), pair.captured_at_ns, pair.captured_at_ns,
              (*t.llh[k].tolist(), *angles[k].tolist()), tuple(t.sigma[k].tolist()))
        for k, pair in enumerate(drive.frame_pairs)
    ]  # fmt: skip
