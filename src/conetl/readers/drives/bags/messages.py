"""Bags of ROS 2 and ROS 1 and MCAP files as streams of messages, in the order of their recording.

A bag folder (metadata.yaml with .mcap or .db3 files) and a .bag file of ROS 1 are read by rosbags' AnyReader; a bare .mcap
file, as Foxglove or a crash of `ros2 bag` leaves it, by the mcap library, its messages by rosbags' type system, or by protobuf.
"""

from __future__ import annotations

import bz2
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import cache, partial
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import mcap.stream_reader
from mcap.reader import McapReader, make_reader
from rosbags.highlevel import AnyReader, anyreader
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag1.reader import Chunk, IndexData, Reader
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2 import storage_mcap as rosbag2_mcap
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

from conetl.files.documents import library_errors, read_yaml
from conetl.model.errors import InputError
from conetl.readers.drives.bags.topics import CAMERA_INFO, TRANSFORMS, USED_TYPES, as_ros, kind_of, protobuf_reader

METADATA = "metadata.yaml"
ROS1_SUFFIX = ".bag"

#: Characters of a topic's name; DDS has no longer ones, and messages quote them.
MAX_TOPIC = 255
#: Largest chunk of messages, uncompressed; recorders make chunks of one to four megabytes, or of one message.
MAX_CHUNK_BYTES = 256 << 20
#: Messages of a bag; 90 bytes of memory each. Ten hours of a rig with a 200 Hz IMU have 8 million.
MAX_MESSAGES = 10_000_000
#: Decompressed bytes of chunks and bytes of messages per byte of the file; LZ4 reaches 255.
MAX_GROWTH = 256
#: What stays free on the disk to which a bag's files are unpacked.
_KEPT_FREE_BYTES = 1 << 30


def _limited(new: Callable[[], Any]) -> Callable[..., bytes]:
    """A function that decompresses at most MAX_CHUNK_BYTES, whatever size is stated. Raises ValueError."""

    def decompress(data: bytes, _stated: int = 0) -> bytes:
        decompressor = new()
        plain: bytes = decompressor.decompress(data, MAX_CHUNK_BYTES)
        if not decompressor.eof:
            raise ValueError(
                f"a compressed chunk is incomplete or larger than {MAX_CHUNK_BYTES >> 20} MB: record smaller chunks"
            )
        return plain

    return decompress


class _Unpacked:
    """A bag's file that is compressed as a whole, unpacked at most to a multiple of its size and to the free space."""

    def __init__(self, file: Any, mode: str) -> None:
        self._file, size = _zstd_file(file, mode), os.fstat(file.fileno()).st_size
        free = shutil.disk_usage(tempfile.gettempdir()).free - _KEPT_FREE_BYTES
        self._left = min(MAX_GROWTH * size, free)

    def __enter__(self) -> _Unpacked:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """Raises ValueError beyond the limit."""
        data: bytes = self._file.read(size)
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(
                f"unpacked, its files need more than the free space of {tempfile.gettempdir()}, or grow more than {MAX_GROWTH} "
                "times: set TMPDIR to a folder with more space"
            )
        return data


# Both libraries allocate what a chunk states, or decompress as much as it makes.
_zstd_file = vars(rosbag2_reader)["zstd"].open
_zstd, _lz4 = _limited(vars(rosbag2_reader)["zstd"].ZstdDecompressor), _limited(lz4.frame.LZ4FrameDecompressor)
rosbag2_mcap.DECOMPRESSORS.update(zstd=_zstd, lz4=_lz4)
vars(rosbag2_reader)["zstd"] = SimpleNamespace(decompress=_zstd, open=_Unpacked)
rosbag1_reader.decompressors.update(bz2=_limited(bz2.BZ2Decompressor), lz4=_lz4)
vars(mcap.stream_reader).update(zstandard=SimpleNamespace(decompress=_zstd), lz4=SimpleNamespace(decompress=_lz4))


class BoundedReader(Reader):
    """ROS 1 bags within bounds: rosbags' reader, with limits on its index and on what is decompressed.

    The index of a bag names messages by chunk and offset, and rosbags believes it: entries that overlap, or chunks that are named
    often, cost more time and memory than the file has bytes. Here all of them together are at most as large as the file, and what
    is read of them at most so many times larger. Of other message types than `USED_TYPES`, which may have any, no definition is
    read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file_bytes = path.stat().st_size
        self._index_bytes = self._chunk_bytes = 0
        self._left = MAX_GROWTH * self._file_bytes + MAX_CHUNK_BYTES

    def read_connection(self) -> Connection:
        """Raises ReaderError."""
        found = super().read_connection()
        if found.msgtype in USED_TYPES:
            return found
        return found._replace(msgdef=MessageDefinition(MessageDefinitionFormat.NONE, ""), digest="")

    def read_chunk(self) -> Chunk:
        """Raises ReaderError, ValueError."""
        chunk = super().read_chunk()
        self._chunk_bytes += chunk.datasize
        if chunk.datasize > MAX_CHUNK_BYTES:
            raise ValueError(f"a chunk is larger than {MAX_CHUNK_BYTES >> 20} MB: record smaller chunks")
        if chunk.datapos + chunk.datasize > self._file_bytes or self._chunk_bytes > self._file_bytes:
            raise ValueError("its index names chunks beyond the end of the file, or twice")
        return chunk._replace(decompressor=partial(self._decompressed, chunk.decompressor))

    def read_index_data(self, pos: int, indexes: dict[int, list[IndexData]]) -> None:
        """Raises ReaderError, ValueError."""
        assert self.bio
        start = self.bio.tell()
        super().read_index_data(pos, indexes)
        self._index_bytes += self.bio.tell() - start
        if self._index_bytes > self._file_bytes:
            raise ValueError("its index contains a message twice")
        if self._index_bytes > 12 * MAX_MESSAGES:
            raise ValueError(
                f"it has more than {MAX_MESSAGES:,} messages; 'rosbag filter' keeps the topics that are needed"
            )

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Raises ReaderError, ValueError."""
        wanted = {connection.id for connection in connections}
        places = attrgetter("chunk_pos", "offset")
        entries = sorted(places(entry) for i in wanted for entry in self.indexes[i])
        if any(one == other for one, other in pairwise(entries)):
            raise ValueError("its index contains a message twice")
        for connection, time_ns, data in super().messages(connections, start, stop):
            if connection.id not in wanted:
                raise ValueError("its index contains messages of other topics")
            self._spend(len(data))
            yield connection, time_ns, data

    def _decompressed(self, decompress: Callable[[bytes], bytes], packed: bytes) -> bytes:
        plain = decompress(packed)
        self._spend(len(plain))
        return plain

    def _spend(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise ValueError(f"it grows to more than {MAX_GROWTH} times its size")


vars(anyreader)["Reader1"] = BoundedReader


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
    """The path to open for a bag: the folder itself, or a bare .mcap or .bag file; None for anything else."""
    if path.suffix in (".mcap", ROS1_SUFFIX) and path.is_file():
        return path
    if not path.is_dir():
        return None
    files = sorted(path.glob("*.mcap"))
    if (path / METADATA).is_file() and parts_of(path):
        return path
    files = files or sorted(path.glob(f"*{ROS1_SUFFIX}"))
    return files[0] if len(files) == 1 else None


def parts_of(path: Path) -> list[Path]:
    """The files of a bag's folder that hold messages."""
    return [part for pattern in ("*.mcap", "*.db3", "*.mcap.zstd", "*.db3.zstd") for part in sorted(path.glob(pattern))]


@contextmanager
def open_bag(path: Path, *, index_only: bool = False) -> Iterator[Bag]:
    """The bag of `bag_files`. Raises InputError where it is truncated or damaged.

    index_only: its messages are not read, so that files that are compressed as a whole need not be unpacked.
    """
    with ExitStack() as opened:
        with _bag_errors(path):
            if path.is_dir() or path.suffix == ROS1_SUFFIX:
                # Within the limits, before rosbags builds it.
                metadata = read_yaml(path / METADATA) if (path / METADATA).is_file() else {}
                if index_only and (found := _bag_of_metadata(metadata)) is not None:
                    yield found
                    return
                types = _ros_types(ros1=not path.is_dir())
                bag = _bag_of_rosbags(opened.enter_context(AnyReader([path], default_typestore=types)), path)
            else:
                bag = _bag_of_file(make_reader(opened.enter_context(path.open("rb")), validate_crcs=True), path)
        yield bag._replace(types={topic: kind for topic, kind in bag.types.items() if len(topic) <= MAX_TOPIC})


def _bag_errors(path: Path) -> AbstractContextManager[None]:
    """All errors of the bag libraries in a damaged file as InputError."""
    of_ros1 = path.suffix == ROS1_SUFFIX
    repair = f"'rosbag reindex {path.name}'" if of_ros1 else "'mcap recover' (MCAP) or 'ros2 bag reindex'"
    return library_errors(f"{path}: the bag cannot be read: it is damaged or cut off", hint=f". {repair} repairs it")


def _bag_of_metadata(content: Any) -> Bag | None:
    """What the metadata say of a bag whose files are compressed as a whole; None of other bags."""
    info = content.get("rosbag2_bagfile_information", {}) if isinstance(content, dict) else {}
    if str(info.get("compression_mode")).lower() != "file":
        return None
    topics = [(each["topic_metadata"], each["message_count"]) for each in info["topics_with_message_count"]]
    first_ns = int(info["starting_time"]["nanoseconds_since_epoch"])
    return Bag(
        {topic["name"]: kind_of(topic["type"]) for topic, _ in topics},
        {topic["name"]: int(count) for topic, count in topics},
        (first_ns, first_ns + int(info["duration"]["nanoseconds"])),
        lambda _: iter(()),
    )


def _bag_of_rosbags(reader: AnyReader, path: Path) -> Bag:
    def messages(topics: Sequence[str]) -> Iterator[Message]:
        wanted = [c for c in reader.connections if c.topic in topics]
        with _bag_errors(path):
            for connection, at_ns, raw in reader.messages(wanted) if wanted else ():
                content = _decoded(reader.deserialize, connection.msgtype, raw)
                if connection.msgtype == CAMERA_INFO and not reader.is2 and content is not None:
                    # Under the names of ROS 2, which are in lower case.
                    content = SimpleNamespace(**{k if len(k) > 1 else k.lower(): v for k, v in vars(content).items()})
                yield Message(connection.topic, content, at_ns)

    ros = _ros_types(ros1=not reader.is2)
    types = {
        # From a ROS 1 bag only the definitions of these types are read.
        c.topic: kind_of(_type_name(reader.typestore, c.msgtype, ros))
        if reader.is2 or c.msgtype in USED_TYPES
        else c.msgtype
        for c in reader.connections
    }
    counts = {topic: info.msgcount for topic, info in reader.topics.items()}
    return Bag(types, counts, (reader.start_time, reader.end_time - 1), messages)  # its end is exclusive


def _bag_of_file(reader: McapReader, path: Path) -> Bag:
    summary = reader.get_summary()
    if summary is None or not summary.channels:
        raise InputError(
            f"{path}: the MCAP file has no summary: the recording was cut off, or the recorder writes none; "
            "'mcap recover' adds it"
        )
    store = get_typestore(Stores.EMPTY)
    for schema in summary.schemas.values():
        if schema.encoding == "ros2msg" and schema.name not in store.types:
            found = get_types_from_msg(schema.data.decode("utf-8"), normalize_msgtype(schema.name))
            store.register({name: fields for name, fields in found.items() if name not in store.types})
    types: dict[str, str] = {}
    decoders: dict[str, Callable[[bytes], Any]] = {}
    for channel in summary.channels.values():
        of_channel, encoding = summary.schemas.get(channel.schema_id), channel.message_encoding
        kind = of_channel.name if of_channel else ""
        read: Callable[[bytes, str], Any] = store.deserialize_cdr
        if of_channel and encoding == "cdr":
            kind = _type_name(store, normalize_msgtype(kind), _ros_types())
        elif of_channel and encoding == of_channel.encoding == "protobuf" and kind_of(kind) != kind:
            read = protobuf_reader(kind, of_channel.data)
        else:
            continue
        types[channel.topic], decoders[channel.topic] = kind_of(kind), partial(_decoded, read, kind)
    indexed = bool(summary.chunk_indexes)

    def messages(topics: Sequence[str]) -> Iterator[Message]:
        wanted = [topic for topic in topics if topic in types]
        # Without an index the file is in the order of recording; to sort it, all of it would be kept in memory.
        with _bag_errors(path):
            for _, channel, message in reader.iter_messages(wanted, log_time_order=indexed) if wanted else ():
                yield Message(channel.topic, decoders[channel.topic](message.data), message.log_time)

    statistics = summary.statistics
    counts = {
        c.topic: statistics.channel_message_counts.get(c.id, 0) if statistics else 0 for c in summary.channels.values()
    }
    recorded_ns = (statistics.message_start_time, statistics.message_end_time) if statistics else (0, 0)
    return Bag(types, counts, recorded_ns, messages)


def _decoded(read: Callable[[bytes, str], Any], kind: str, data: bytes) -> Any:
    """Fields of a message as attributes, under the names of ROS; None where its bytes do not match its type."""
    try:
        message = read(data, kind)
        return message if kind_of(kind) == kind else as_ros(message)
    except Exception:  # of many types; a stated length may also exceed the memory
        return None


def _type_name(store: Typestore, name: str, ros: Typestore) -> str:
    """The name of a message type; with a remark where the bag defines other fields than ROS."""
    try:
        same = name not in ros.fielddefs or store.hash_rihs01(name) == ros.hash_rihs01(name)
    except Exception:  # of many types, for a definition that refers to what the bag does not define
        same = False
    return name if same else f"{name} with other fields"


@cache
def _ros_types(*, ros1: bool = False) -> Typestore:
    """Types of ROS 2, or of ROS 1 with the one of tf2 that rosbags has only for ROS 2."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register({TRANSFORMS: _ros_types().fielddefs[TRANSFORMS]})
    return store
