"""ROS 2 bags and MCAP files as streams of messages, in the order of their recording.

A bag folder (metadata.yaml with .mcap or .db3 files) is read by rosbags' AnyReader; a bare .mcap file, as Foxglove or a crash of
`ros2 bag` leaves it, by the mcap library, its messages by rosbags' type system.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Schema
from mcap.stream_reader import CRCValidationError
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from conetl.model.errors import DriveFolderError
from conetl.readers.drives.drive_yaml import is_bare_bag

METADATA = "metadata.yaml"
#: Errors of reading one message whose bytes do not match its type.
_NOT_DECODED = (SerdeError, AnyReaderError, struct.error, ValueError, IndexError, KeyError, UnicodeDecodeError)


class Message(NamedTuple):
    """One message."""

    topic: str
    content: Any
    """Its fields as attributes, as in ROS; None where it cannot be decoded."""
    recorded_at_ns: int
    """When the recorder wrote it; not the time of its content."""


class Bag(NamedTuple):
    """An open bag."""

    types: Mapping[str, str]
    """Message type by topic, like sensor_msgs/msg/Image."""
    counts: Mapping[str, int]
    """Messages by topic."""
    recorded_ns: tuple[int, int]
    """Times of the first and last message, by the recorder's clock."""
    messages: Callable[[Sequence[str]], Iterator[Message]]
    """Called with topics; one message is in memory at a time."""


def bag_files(path: Path) -> Path | None:
    """What to open of a bag: the folder itself, or a bare .mcap file; None for anything else."""
    if is_bare_bag(path):
        return path
    if not path.is_dir():
        return None
    files = sorted(path.glob("*.mcap"))
    if (path / METADATA).is_file() and (files or any(path.glob("*.db3"))):
        return path
    return files[0] if len(files) == 1 else None


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """The bag of `bag_files`. Raises DriveFolderError where it is cut off or damaged."""
    try:
        if path.is_dir():
            with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                yield _bag_of_folder(reader)
        else:
            with path.open("rb") as file:
                yield _bag_of_file(make_reader(file, validate_crcs=True), path)
    except (McapError, AnyReaderError, ReaderError, TypesysError, CRCValidationError, OSError) as error:
        text = str(error) or type(error).__name__
        raise DriveFolderError(
            f"{path}: the bag cannot be read: {text}. A recording that was cut off is repaired by 'mcap recover' (MCAP) or "
            "'ros2 bag reindex'"
        ) from error


def _bag_of_folder(reader: AnyReader) -> Bag:
    def messages(topics: Sequence[str]) -> Iterator[Message]:
        wanted = [c for c in reader.connections if c.topic in topics]
        for connection, at_ns, raw in reader.messages(wanted) if wanted else ():
            try:
                content: Any = reader.deserialize(raw, connection.msgtype)
            except _NOT_DECODED:
                content = None
            yield Message(connection.topic, content, at_ns)

    types = {c.topic: c.msgtype for c in reader.connections}
    counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    return Bag(types, counts, (reader.start_time, reader.end_time - 1), messages)  # its end is exclusive


def _bag_of_file(reader: McapReader, path: Path) -> Bag:
    summary = reader.get_summary()
    if summary is None or not summary.channels:
        raise DriveFolderError(
            f"{path}: the MCAP file has no summary: the recording was cut off, or the recorder writes none; "
            "'mcap recover' adds it"
        )
    store = get_typestore(Stores.EMPTY)
    for schema in summary.schemas.values():
        if schema.encoding == "ros2msg" and schema.name not in store.types:
            found = get_types_from_msg(schema.data.decode("utf-8"), _ros_name(schema))
            store.register({name: fields for name, fields in found.items() if name not in store.types})
    types = {
        channel.topic: _ros_name(summary.schemas[channel.schema_id])
        for channel in summary.channels.values()
        if channel.message_encoding == "cdr" and channel.schema_id in summary.schemas
    }
    indexed = bool(summary.chunk_indexes)

    def messages(topics: Sequence[str]) -> Iterator[Message]:
        wanted = [topic for topic in topics if topic in types]
        # Without an index the file is in the order of recording; to sort it, all of it would be kept in memory.
        for _, channel, message in reader.iter_messages(wanted, log_time_order=indexed) if wanted else ():
            try:
                content: Any = store.deserialize_cdr(message.data, types[channel.topic])
            except _NOT_DECODED:
                content = None
            yield Message(channel.topic, content, message.log_time)

    statistics = summary.statistics
    counts = {
        c.topic: statistics.channel_message_counts.get(c.id, 0) if statistics else 0 for c in summary.channels.values()
    }
    recorded_ns = (statistics.message_start_time, statistics.message_end_time) if statistics else (0, 0)
    return Bag(types, counts, recorded_ns, messages)


def _ros_name(schema: Schema) -> str:
    """sensor_msgs/msg/Image, also where the recorder wrote sensor_msgs/Image."""
    words = schema.name.split("/")
    return schema.name if len(words) != 2 else f"{words[0]}/msg/{words[1]}"
