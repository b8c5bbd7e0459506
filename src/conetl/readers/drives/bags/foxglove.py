"""Foxglove's message types, in protobuf or as ROS messages, under the names of the ROS types that mean the same."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from conetl.readers.drives.bags.topics import CAMERA_INFO, COMPRESSED, FIX, RAW, TRANSFORMS, VIDEO

_KINDS = {
    "CompressedImage": COMPRESSED, "RawImage": RAW, "CompressedVideo": VIDEO, "CameraCalibration": CAMERA_INFO,
    "LocationFix": FIX, "FrameTransform": TRANSFORMS, "FrameTransforms": TRANSFORMS,
}  # fmt: skip


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
