"""One recording in the layouts of its makers: KITTI odometry, folders and names of many programs, GoPro chapters, Foxglove.

Structure from public documentation; images and poses are those of a sample drive.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import Writer as McapWriter
from scipy.spatial.transform import Rotation

from conetl.geometry import rig as rigs
from conetl.model.drive import Drive
from conetl.model.rig import Rig
from conetl.readers.rigs import write_rig_yaml
from tests.unit.readers import drive_formats as formats
from tests.unit.readers.drive_formats import Frame, T
from tests.unit.readers.trajectory_files import write_csv
from tests.video_drives import known_of, write_frames


@dataclass(frozen=True)
class Recorded:
    """What is written."""

    drive: Drive
    frames: list[Frame]

    @property
    def rig(self) -> Rig:
        return self.drive.rig

    def image(self, number: int, side: str) -> np.ndarray:
        data = getattr(self.frames[number], side)
        return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))


@dataclass(frozen=True)
class Layout:
    """How a program lays out a recording, and what a person states."""

    write: Callable[[Path, Recorded], Path]
    """Writes it below a folder; returns the drive."""
    init: Sequence[str] | None = None
    """Options of `conetl init`; None of a layout that is a drive as it is."""
    refused: str | None = None
    """What is said of one that cannot be a drive."""
    far_m: float = 2e-3
    """How far cameras may be from those of the sample drive."""
    far_rad: float = 1e-4
    off_grey: float = 1.0
    """Mean difference of grey levels of the images."""
    cones_m: float | None = 0.02
    """How far cones may be from those of the sample drive; None of images with less detail: as their own sigmas state it."""


def encoded(suffix: str, image: np.ndarray) -> bytes:
    flags = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    return bytes(cv2.imencode(suffix, image, flags)[1])


def beside(root: Path, r: Recorded, rig: Rig | None = None) -> Path:
    """The log and the calibration."""
    write_csv(root, known_of(r.drive))
    write_rig_yaml(rig or r.rig, root / "rig.yaml")
    return root


def folders(
    root: Path,
    r: Recorded,
    *,
    left: str = "left",
    right: str = "right",
    name: Callable[[int, int], str] = lambda n, ns: f"{ns}",
    suffix: str = ".jpg",
    change: Callable[[np.ndarray], np.ndarray] | None = None,
    times: Callable[[Path, Recorded], object] = lambda root, r: None,
) -> Path:
    """Two cameras in folders, or in one: then `left` and `right` are forms of file names."""
    for n, frame in enumerate(r.frames):
        for side, form in (("left", left), ("right", right)):
            stem = name(n, frame.stamp_ns)
            path = root / (f"{form.format(stem)}{suffix}" if "{" in form else f"{form}/{stem}{suffix}")
            path.parent.mkdir(parents=True, exist_ok=True)
            data = getattr(frame, side)
            if change is not None or suffix != ".jpg":
                image = r.image(n, side)
                data = encoded(".png" if suffix == ".jpg" else suffix, image if change is None else change(image))
                path = path.with_suffix(".png") if suffix == ".jpg" else path
            path.write_bytes(data)
    times(root, r)
    return beside(root, r)


def number(n: int, ns: int) -> str:
    return f"{n:06d}"


def lines(root: Path, name: str, made: Sequence[str]) -> None:
    (root / name).write_text("\n".join(made) + "\n")


def times_txt(root: Path, r: Recorded) -> None:
    lines(root, "times.txt", [f"{frame.stamp_ns}" for frame in r.frames])


def relative_times(root: Path, r: Recorded, first: int = 0) -> None:
    lines(root, "times.txt", [f"{(f.stamp_ns - r.frames[0].stamp_ns) * 1e-9:.9e}" for f in r.frames[first:]])


def rgb_txt(root: Path, r: Recorded) -> None:
    """TUM's list: times and names."""
    made = [
        f"{frame.stamp_ns // 10**9}.{frame.stamp_ns % 10**9:09d} left/{n:06d}.jpg" for n, frame in enumerate(r.frames)
    ]
    lines(root, "rgb.txt", ["# color images", "# timestamp filename", *made])
    lines(root, "right.txt", [line.replace("left/", "right/") for line in made])


def start_of(r: Recorded) -> str:
    return f"images.start={np.datetime64(r.frames[0].stamp_ns, 'ns')}Z".replace("T", " ")


def camera_poses(r: Recorded) -> np.ndarray:
    """(N, 4, 4) of the left camera in the map."""
    return np.array([rigs.map_SE3_left(pair.pose, r.rig) for pair in r.drive.frame_pairs])


def kitti_odometry(root: Path, r: Recorded, *, cameras: tuple[int, int] = (2, 3), upright: bool = False) -> Path:
    """Poses in the frame of the first camera; upright: in a level frame at the first body."""
    for n, frame in enumerate(r.frames):
        for side, camera in zip(("left", "right"), cameras, strict=True):
            (root / f"image_{camera}").mkdir(parents=True, exist_ok=True)
            (root / f"image_{camera}" / f"{n:06d}.jpg").write_bytes(getattr(frame, side))
    origin = formats.origin_of(r.frames)
    body = np.array([formats.local_pose(origin, frame.oxts) for frame in r.frames if frame.oxts])
    frame_SE3_left = body @ rigs.body_SE3_camera(r.rig, "left")
    poses = frame_SE3_left if upright else np.linalg.inv(frame_SE3_left[0]) @ frame_SE3_left
    lines(root, "poses.txt", [" ".join(f"{v:.9e}" for v in pose[:3].reshape(-1)) for pose in poses])
    relative_times(root, r)
    write_rig_yaml(r.rig, root / "rig.yaml")
    return root


def kitti_object(root: Path, r: Recorded) -> Path:
    for n, frame in enumerate(r.frames):
        for folder, data in (("image_2", frame.left), ("image_3", frame.right), ("calib", b"P0: 1\nP2: 1\n")):
            (root / folder).mkdir(parents=True, exist_ok=True)
            (root / folder / f"{n:06d}{'.txt' if folder == 'calib' else '.jpg'}").write_bytes(data or b"")
    return root


def kitti_raw_with_csv(root: Path, r: Recorded) -> Path:
    formats.write_kitti(root, [replace(frame, oxts=None) for frame in r.frames], r.rig)
    for path in (root / "oxts/data", root / "oxts"):
        for file in path.glob("*.txt"):
            file.unlink()
        path.rmdir()
    for path in root.glob("calib_*.txt"):
        path.unlink()
    return beside(root, r)


def videos(root: Path, r: Recorded, names: dict[str, Sequence[str]]) -> Path:
    """Chapters of equal length by side."""
    height = r.rig.left.height_px // 2 * 2
    for side, chapters in names.items():
        parts = np.array_split(np.arange(len(r.frames)), len(chapters))
        for name, part in zip(chapters, parts, strict=True):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            images = [r.image(n, side)[:height] for n in part]
            # GoPro's chapters follow each other by the nominal rate.
            write_frames(root / name, images, [10**8 * k for k in range(len(part))], "libx264", {"crf": "12"})
    return beside(root, r)


# --------------------------------------------------------------------------- bags


def bag(root: Path, r: Recorded, **options: Any) -> Path:
    return formats.write_bag(root / "run", r.frames, r.rig, **options)


def mosaic_of(image: np.ndarray) -> np.ndarray:
    """RGGB."""
    mosaic = image[..., 1].copy()
    mosaic[::2, ::2] = image[::2, ::2, 2]
    mosaic[1::2, 1::2] = image[1::2, 1::2, 0]
    return mosaic


def bayer(stamp_ns: int, frame_id: str, data: bytes) -> tuple[str, Any]:
    kind = "sensor_msgs/msg/CompressedImage"
    mosaic = mosaic_of(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    packed = np.frombuffer(encoded(".png", mosaic), np.uint8)
    return kind, T[kind](header=formats.header(stamp_ns, frame_id), format="bayer_rggb8; png compressed ", data=packed)


def changed_infos(root: Path, r: Recorded, change: Callable[[np.ndarray], np.ndarray], **values: Any) -> Path:
    """A bag whose cameras have a region of interest or binning."""

    def image(stamp_ns: int, frame_id: str, data: bytes) -> tuple[str, Any]:
        stored = change(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
        return formats.compressed(stamp_ns, frame_id, encoded(".png", stored))

    def mangle(topic: str, number: int, data: bytes) -> bytes:
        if not topic.endswith("camera_info"):
            return data
        kind = "sensor_msgs/msg/CameraInfo"
        info = formats.STORE.deserialize_cdr(data, kind)
        roi = T["sensor_msgs/msg/RegionOfInterest"](**{**ROI, **values.get("roi", {})}, do_rectify=False)
        fields = {name: getattr(info, name) for name, _ in formats.STORE.fielddefs[kind][1]}
        fields |= {"roi": roi, "binning_x": values.get("binning", 0), "binning_y": values.get("binning", 0)}
        return bytes(formats.STORE.serialize_cdr(T[kind](**fields), kind))

    return bag(root, r, image=image, mangle=mangle)


ROI = {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0}


def binned(image: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


# --------------------------------------------------------------------------- Foxglove

_NUMBER = {"double": 1, "uint32": 13, "string": 9, "bytes": 12, "int64": 3, "int32": 5, "message": 11}
_TIME = ".google.protobuf.Timestamp"
_MESSAGES: dict[str, dict[str, str]] = {
    "Vector3": dict.fromkeys("xyz", "double"), "Quaternion": dict.fromkeys("xyzw", "double"),
    "CompressedImage": {"timestamp": _TIME, "frame_id": "string", "data": "bytes", "format": "string"},
    "CompressedVideo": {"timestamp": _TIME, "frame_id": "string", "data": "bytes", "format": "string"},
    "CameraCalibration": {
        "timestamp": _TIME, "frame_id": "string", "width": "uint32", "height": "uint32", "distortion_model": "string",
        "D": "double*", "K": "double*", "R": "double*", "P": "double*",
    },
    "LocationFix": {
        "timestamp": _TIME, "frame_id": "string", "latitude": "double", "longitude": "double", "altitude": "double",
        "position_covariance": "double*", "position_covariance_type": "int32",
    },
    "FrameTransform": {
        "timestamp": _TIME, "parent_frame_id": "string", "child_frame_id": "string", "translation": ".foxglove.Vector3",
        "rotation": ".foxglove.Quaternion",
    },
}  # fmt: skip


def foxglove_schemas() -> tuple[bytes, dict[str, Any]]:
    """A FileDescriptorSet and the classes of the messages."""
    time = FileDescriptorProto(name="google/protobuf/timestamp.proto", package="google.protobuf", syntax="proto3")
    own = FileDescriptorProto(name="foxglove/all.proto", package="foxglove", syntax="proto3", dependency=[time.name])
    stamp = time.message_type.add(name="Timestamp")
    for n, (name, kind) in enumerate({"seconds": "int64", "nanos": "int32"}.items(), 1):
        stamp.field.add(name=name, number=n, type=_NUMBER[kind], label=FieldDescriptorProto.LABEL_OPTIONAL)
    for message, fields in _MESSAGES.items():
        added = own.message_type.add(name=message)
        for n, (name, kind) in enumerate(fields.items(), 1):
            label = FieldDescriptorProto.LABEL_REPEATED if kind.endswith("*") else FieldDescriptorProto.LABEL_OPTIONAL
            field_type = _NUMBER["message"] if kind.startswith(".") else _NUMBER[kind.rstrip("*")]
            added.field.add(name=name, number=n, type=field_type, label=label, type_name=kind if "." in kind else None)
    pool = DescriptorPool()
    pool.Add(time)
    pool.Add(own)
    classes = {name: GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}")) for name in _MESSAGES}
    return FileDescriptorSet(file=[time, own]).SerializeToString(), classes


def h264_packets(images: Sequence[np.ndarray]) -> list[bytes]:
    """One access unit per image, without B frames, as Foxglove asks for."""
    codec = av.CodecContext.create("libx264", "w")
    codec.height, codec.width = images[0].shape[:2]
    codec.pix_fmt, codec.time_base, codec.framerate = "yuv420p", Fraction(1, 10), Fraction(10, 1)
    codec.options = {"crf": "12", "bf": "0", "tune": "zerolatency", "x264-params": "chromaloc=1"}
    packets: list[bytes] = []
    for n, image in enumerate(images):
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
        frame.pts = n
        packets += [bytes(packet) for packet in codec.encode(frame)]
    return packets + [bytes(packet) for packet in codec.encode(None)]


def foxglove(root: Path, r: Recorded, *, video: bool = False) -> Path:
    """An MCAP file in protobuf: images or video, calibration, transforms, and positions without attitude."""
    path = root / "run.mcap"
    descriptors, classes = foxglove_schemas()
    bottom = r.rig.left.height_px // 2 * 2 if video else r.rig.left.height_px
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        ids: dict[str, int] = {}

        def add(topic: str, kind: str, at_ns: int, **values: Any) -> None:
            message = classes[kind](**values)
            message.timestamp.seconds, message.timestamp.nanos = divmod(at_ns, 10**9)
            if topic not in ids:
                schema = writer.register_schema(f"foxglove.{kind}", "protobuf", descriptors)
                ids[topic] = writer.register_channel(topic, "protobuf", schema)
            writer.add_message(ids[topic], at_ns, message.SerializeToString(), at_ns)

        first = r.frames[0].stamp_ns
        for side, info in formats.camera_infos(r.rig, root / "infos").items():
            add(
                f"/{side}/calibration", "CameraCalibration", first, frame_id=f"{side}_optical", width=info.width, height=bottom,
                distortion_model=info.distortion_model, **{key.upper(): getattr(info, key).tolist() for key in "dkrp"},
            )  # fmt: skip
        pose = rigs.body_SE3_camera(r.rig, "left")
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        add(
            "/tf", "FrameTransform", first, parent_frame_id="base_link", child_frame_id="left_optical",
            translation=dict(zip("xyz", pose[:3, 3].tolist(), strict=True)), rotation={"x": x, "y": y, "z": z, "w": w},
        )  # fmt: skip
        packets = {
            s: h264_packets([r.image(n, s)[:bottom] for n in range(len(r.frames))]) for s in ("left", "right") if video
        }
        for n, frame in enumerate(r.frames):
            assert frame.oxts is not None
            for side in ("left", "right"):
                kind, data = (
                    ("CompressedVideo", packets[side][n]) if video else ("CompressedImage", getattr(frame, side))
                )
                add(
                    f"/{side}/image",
                    kind,
                    frame.stamp_ns,
                    frame_id=f"{side}_optical",
                    data=data,
                    format="h264" if video else "jpeg",
                )
            lat, lon, height = frame.oxts[:3]
            covariance = np.diag(np.square(frame.sigmas[:3])).reshape(-1).tolist()
            add(
                "/fix", "LocationFix", frame.stamp_ns, frame_id="base_link", latitude=lat, longitude=lon, altitude=height,
                position_covariance=covariance, position_covariance_type=2,
            )  # fmt: skip
        writer.finish()
    return path


# --------------------------------------------------------------------------- the table

CHAPTERS = {"left": ("left/GX010042.MP4", "left/GX020042.MP4"), "right": ("right/GX010057.MP4", "right/GX020057.MP4")}
ONE_FOLDER = {
    "left": ("GX010042_L.MP4", "GX020042_L.MP4"), "right": ("GX010042_R.MP4", "GX020042_R.MP4"),
}  # fmt: skip
OLD_NAMES = {"left": ("left/GOPR0042.MP4", "left/GP010042.MP4"), "right": ("right/GOPR0042.MP4", "right/GP010042.MP4")}
REGION = {"x_offset": 100, "y_offset": 40, "width": 800, "height": 240}
POSITIONS = {"far_m": 0.02, "far_rad": 2e-2}
VIDEO = {"off_grey": 3.0}


def layouts(georeference: str) -> dict[str, Layout]:
    """Thirty and more. georeference: of local poses, in YAML."""
    odometry = (f"georeference={georeference}", "sigmas.horizontal_m=0.02", "START")
    start = ("START", "images.right_offset_s=0")
    return {
        "KITTI odometry, colour": Layout(kitti_odometry, odometry),
        "KITTI odometry, grey": Layout(partial(kitti_odometry, cameras=(0, 1)), odometry),
        "poses in a level frame": Layout(partial(kitti_odometry, upright=True), odometry),
        "KITTI object": Layout(kitti_object, (), refused="one calibration per image.*conetl locate"),
        "KITTI raw with a log": Layout(kitti_raw_with_csv, ()),
        "*_left, *_right": Layout(partial(folders, left="{}_left", right="{}_right"), ()),
        "left_*, right_* in a folder": Layout(
            partial(folders, left="data/left_{}", right="data/right_{}", name=number, times=times_txt), ()
        ),
        "cam0_*, cam1_*": Layout(partial(folders, left="cam0_{}", right="cam1_{}"), ()),
        "left0001, right0001": Layout(partial(folders, left="left{}", right="right{}", name=number, times=times_txt), ()),
        "*_L, *_R": Layout(partial(folders, left="{}_L", right="{}_R"), ()),
        "cam0/data, cam1/data": Layout(partial(folders, left="cam0/data", right="cam1/data"), ()),
        "left/rgb, right/rgb": Layout(partial(folders, left="left/rgb", right="right/rgb"), ()),
        "TIFF": Layout(partial(folders, suffix=".tiff"), ()),
        "BMP": Layout(partial(folders, suffix=".bmp"), ()),
        "WebP": Layout(partial(folders, suffix=".webp"), ()),
        "times.txt": Layout(partial(folders, name=number, times=times_txt), ()),
        "seconds of the recording": Layout(partial(folders, name=number, times=relative_times), ("START",)),
        "TUM's rgb.txt": Layout(
            partial(folders, name=number, times=rgb_txt), ("images.timestamps=rgb.txt", "images.right_timestamps=right.txt")
        ),
        "frame numbers alone": Layout(partial(folders, name=number), ("--yes",)),
        "rows cropped": Layout(
            partial(folders, change=lambda image: image[40:280]), ("images.crop=[0, 40, 960, 240]",)
        ),
        "rows padded": Layout(
            partial(folders, change=lambda image: cv2.copyMakeBorder(image, 32, 32, 0, 0, cv2.BORDER_CONSTANT)),
            ("images.crop=[0, -32, 960, 384]",),
        ),
        "binned": Layout(
            partial(folders, change=binned), ("images.crop=[0, 0, 960, 320]", "images.binning=2"), off_grey=8.0, cones_m=None
        ),
        "GoPro chapters in folders": Layout(partial(videos, names=CHAPTERS), start, **VIDEO),
        "GoPro chapters in one folder": Layout(partial(videos, names=ONE_FOLDER), start, **VIDEO),
        "GoPro chapters, old names": Layout(partial(videos, names=OLD_NAMES), start, **VIDEO),
        "GoPro, a chapter lost": Layout(
            partial(videos, names={"left": ("GX010042_L.MP4", "GX030042_L.MP4"), "right": ONE_FOLDER["right"]}), start,
            refused="chapter 2 of this recording is missing",
        ),
        "EuRoC": Layout(lambda root, r: formats.write_euroc(root / "run", r.frames, r.rig)),
        "plain": Layout(lambda root, r: formats.write_plain(root / "run", r.frames, r.rig)),
        "ROS 2 bag": Layout(bag),
        ".db3.zstd": Layout(lambda root, r: formats.packed_bag(root, r.frames, r.rig)),
        "ROS 1 bag": Layout(lambda root, r: formats.write_ros1_bag(root / "run", r.frames, r.rig)),
        "Bayer in CompressedImage": Layout(partial(bag, image=bayer), off_grey=6.0, cones_m=None),
        "CameraInfo with a region": Layout(
            partial(changed_infos, change=lambda image: image[40:280, 100:900], roi=REGION)
        ),
        "CameraInfo with binning": Layout(
            partial(changed_infos, change=binned, binning=2), off_grey=8.0, cones_m=None
        ),
        "Foxglove images": Layout(foxglove, **POSITIONS),
        "Foxglove video": Layout(partial(foxglove, video=True), **POSITIONS, **VIDEO),
    }  # fmt: skip
