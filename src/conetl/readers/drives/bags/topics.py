"""The topics of a bag by their meaning, types of other makers, and the rig of its CameraInfo and /tf_static messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from conetl.files.documents import MAX_SHOWN
from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.errors import InputError
from conetl.model.rig import Rig
from conetl.readers.drives.drive_yaml import Streams
from conetl.readers.drives.poses import rotation_of
from conetl.readers.rigs.common import Node
from conetl.readers.rigs.ros import rig_of_camera_infos

COMPRESSED, RAW = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
CAMERA_INFO, FIX, IMU = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu"
ODOMETRY, TRANSFORMS, TF_STATIC = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "/tf_static"
#: One frame of a video in each message (foxglove.CompressedVideo, foxglove_msgs/msg/CompressedVideo).
VIDEO = "foxglove_msgs/msg/CompressedVideo"
USED_TYPES = frozenset({COMPRESSED, RAW, CAMERA_INFO, FIX, IMU, ODOMETRY, TRANSFORMS, VIDEO})

#: Types of Foxglove, in protobuf or as ROS messages, and those of ROS that mean the same.
_KINDS = {
    "CompressedImage": COMPRESSED, "RawImage": RAW, "CompressedVideo": VIDEO, "CameraCalibration": CAMERA_INFO,
    "LocationFix": FIX, "FrameTransform": TRANSFORMS, "FrameTransforms": TRANSFORMS,
}  # fmt: skip
#: Characters of a list of topics in a message.
_MAX_LISTED = 600


class Topics(NamedTuple):
    """Topics of one drive."""

    left: str
    right: str
    left_info: str | None
    right_info: str | None
    trajectory: str
    """NavSatFix or Odometry."""
    imu: str | None
    """Of a NavSatFix; None: the attitude is that of its course."""
    is_local: bool
    """Whether the trajectory is an Odometry."""


def choose_topics(types: Mapping[str, str], streams: Streams, source: Path) -> Topics:
    """Topics as named in drive.yaml (streams), else by type, else by name.

    Raises InputError where topics are missing or ambiguous.
    """
    for key, topic in streams.model_dump(exclude_none=True).items():
        if topic not in types:
            raise InputError(
                f"{source}: drive.yaml: streams.{key}: the bag has no topic {topic[:MAX_SHOWN]}; {_listing(types)}"
            )
    left, right = _cameras(types, streams, source)
    infos = {t for t, kind in types.items() if kind == CAMERA_INFO}
    trajectory = (
        streams.trajectory or _only(types, FIX, "trajectory", source) or _only(types, ODOMETRY, "trajectory", source)
    )
    if trajectory is None:
        raise InputError(f"{source}: the bag has no trajectory ({FIX} with {IMU}, or {ODOMETRY}); {_listing(types)}")
    kind = types[trajectory]
    if kind not in (FIX, ODOMETRY):
        raise InputError(
            f"{source}: drive.yaml: streams.trajectory: {trajectory} is a {kind}, expected {FIX} or {ODOMETRY}"
        )
    imu = (streams.imu or _only(types, IMU, "imu", source)) if kind == FIX else None
    left_info, right_info = streams.left_info or _info_of(left, infos), streams.right_info or _info_of(right, infos)
    return Topics(left, right, left_info, right_info, trajectory, imu, kind == ODOMETRY)


def _cameras(types: Mapping[str, str], streams: Streams, source: Path) -> tuple[str, str]:
    if streams.left and streams.right:
        return streams.left, streams.right
    for kind in (COMPRESSED, RAW, VIDEO):
        topics = sorted(t for t, k in types.items() if k == kind)
        sides = [[t for t in topics if side in t.lower() and other not in t.lower()]
                 for side, other in (("left", "right"), ("right", "left"))]  # fmt: skip
        if len(sides[0]) == 1 and len(sides[1]) == 1:
            return streams.left or sides[0][0], streams.right or sides[1][0]
    raise InputError(
        f"{source}: the topics of the left and the right camera are unknown: expected one {COMPRESSED}, {RAW} or {VIDEO} topic "
        f"each with left and right in its name; name them in drive.yaml (streams.left, streams.right); {_listing(types)}"
    )


def _only(types: Mapping[str, str], kind: str, key: str, source: Path) -> str | None:
    found = sorted(t for t, k in types.items() if k == kind)
    if len(found) > 1:
        raise InputError(
            f"{source}: {len(found)} topics are {kind}: {', '.join(found)[:_MAX_LISTED]}; name one in drive.yaml (streams.{key})"
        )
    return found[0] if found else None


def _info_of(topic: str, infos: set[str]) -> str | None:
    """The camera_info in the nearest namespace of an image topic, else the only CameraInfo in its own."""
    namespaces = PurePosixPath(topic).parents
    beside = [name for name in infos if PurePosixPath(name).parent == namespaces[0]]
    named = (name for parent in namespaces if (name := str(parent / "camera_info")) in infos)
    return next(named, beside[0] if len(beside) == 1 else None)


def _listing(types: Mapping[str, str]) -> str:
    return f"found {', '.join(f'{t} ({k})' for t, k in sorted(types.items()))[:_MAX_LISTED] or 'no topics'}"


def rig_of_infos(topics: Topics, infos: Mapping[str, Any], source: Path) -> Rig:
    """The rig as the images are stored; its body is the left camera. Raises InputError.

    Topics called image_rect... have rectified images: P is their camera, and neither D nor R applies.
    """
    found = []
    for side, image, info in (("left", topics.left, topics.left_info), ("right", topics.right, topics.right_info)):
        if info is None or info not in infos:
            raise InputError(
                f"{source}: there is no CameraInfo for the {side} camera {image}; name it in drive.yaml (streams.{side}_info) "
                "or put a rig.yaml beside the bag"
            )
        found.append(Node(Path(f"{source}:{info}"), _camera_info(infos[info], rectified=is_rectified_topic(image))))
    return rig_of_camera_infos(*found)


def is_rectified_topic(topic: str) -> bool:
    """True for image_rect, image_rect_color ... with any transport after it (image_proc's names)."""
    return any(part.startswith("image_rect") for part in topic.split("/"))


def _camera_info(message: Any, *, rectified: bool) -> dict[str, Any]:
    """A CameraInfo message under the keys of its YAML file."""
    (x, y, width, height), (across, down) = _part_of(message)
    # Points of the calibration's images -> points of the stored ones; both count from the centre of a pixel.
    stored = np.array(
        [[1 / across, 0, (0.5 - x) / across - 0.5], [0, 1 / down, (0.5 - y) / down - 0.5], [0, 0, 1]], dtype=np.float64
    )
    projection = stored @ np.asarray(message.p, dtype=np.float64).reshape(3, 4)
    return {
        "image_width": width // across,
        "image_height": height // down,
        "camera_matrix": projection[:, :3] if rectified else stored @ np.asarray(message.k).reshape(3, 3),
        "distortion_model": "plumb_bob" if rectified else str(message.distortion_model) or "plumb_bob",
        "distortion_coefficients": [] if rectified else np.asarray(message.d),
        "rectification_matrix": np.eye(3) if rectified else np.asarray(message.r).reshape(3, 3),
        "projection_matrix": projection,
    }


def _part_of(message: Any) -> tuple[tuple[int, int, int, int], tuple[int, int]]:
    """The part of the calibration's images that is stored (x, y, width, height), and how many of its pixels are one, across and
    down: region of interest and binning of a CameraInfo."""
    roi: Any = getattr(message, "roi", None)
    part = (0, 0, message.width, message.height)
    if roi is not None and roi.width and roi.height:
        part = (roi.x_offset, roi.y_offset, roi.width, roi.height)
    across, down = (max(int(getattr(message, f"binning_{axis}", 1)), 1) for axis in "xy")
    x, y, width, height = map(int, part)
    return (x, y, width, height), (across, down)


def transforms_of(message: Any) -> dict[tuple[str, str], Floats]:
    """parent_SE3_child (4, 4) by the names of both frames, without a leading slash, of a TFMessage; invalid ones are left out."""
    found: dict[tuple[str, str], Floats] = {}
    for transform in message.transforms:
        t, q = transform.transform.translation, transform.transform.rotation
        with suppress(ValueError):
            pose = se3.se3(rotation_of(q.w, q.x, q.y, q.z), [t.x, t.y, t.z])
            found[transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")] = pose
    return found


# -------------------------------------------------------------------------- messages of Foxglove under the names of ROS


def kind_of(name: str) -> str:
    """The ROS type that means the same as a schema (foxglove.X, foxglove_msgs/msg/X); the name itself of others."""
    package, _, last = name.replace("/msg/", ".").rpartition(".")
    return _KINDS.get(last, name) if package in ("foxglove", "foxglove_msgs") else name


def protobuf_reader(name: str, descriptors: bytes) -> Callable[[bytes, str], Any]:
    """A function that reads messages of a schema in protobuf; descriptors: its FileDescriptorSet, imports first.

    Raises TypeError, KeyError or DecodeError where the schema is damaged.
    """
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(descriptors).file:
        pool.Add(file)
    read = GetMessageClass(pool.FindMessageTypeByName(name)).FromString
    return lambda data, _: read(data)


def as_ros(message: Any) -> Any:
    """Fields of a message of Foxglove under the names of ROS. Raises AttributeError where some are missing."""
    if hasattr(message, "transforms"):
        return SimpleNamespace(transforms=[_transform(each) for each in message.transforms])
    if hasattr(message, "parent_frame_id"):
        return SimpleNamespace(transforms=[_transform(message)])
    names = message.DESCRIPTOR.fields_by_name if hasattr(message, "DESCRIPTOR") else vars(message)
    values: dict[str, Any] = {name.lower() if len(name) == 1 else name: getattr(message, name) for name in names}
    for key, count in (("k", 9), ("r", 9), ("p", 12), ("position_covariance", 9)):
        if key in values:
            values[key] = (
                np.resize(np.asarray(values[key], dtype=np.float64), count) if len(values[key]) else np.zeros(count)
            )
    if "data" in values:
        values["data"] = np.frombuffer(bytes(values["data"]), dtype=np.uint8)
    return SimpleNamespace(header=_header(message.timestamp, message.frame_id), **values)


def _header(stamp: Any, frame_id: str) -> SimpleNamespace:
    """seconds, nanos of protobuf; sec, nanosec of ROS."""
    seconds, nanos = (stamp.seconds, stamp.nanos) if hasattr(stamp, "seconds") else (stamp.sec, stamp.nanosec)
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanos), frame_id=frame_id)


def _transform(message: Any) -> SimpleNamespace:
    return SimpleNamespace(
        header=_header(message.timestamp, message.parent_frame_id), child_frame_id=message.child_frame_id,
        transform=SimpleNamespace(translation=message.translation, rotation=message.rotation),
    )  # fmt: skip
