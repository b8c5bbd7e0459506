"""Bags of ROS 2 and ROS 1 and MCAP files as streams of messages, in the order of their recording, and the images in them.

A bag folder (metadata.yaml with .mcap or .db3 files) and a .bag file of ROS 1 are read by rosbags' AnyReader; a bare .mcap
file, as Foxglove or a crash of `ros2 bag` leaves it, by the mcap library, its messages by rosbags' type system. Each image is
unpacked once into a folder, under the hash of its bytes: compressed ones as they were recorded, byte for byte, raw ones as
PNG, which loses nothing.
"""

from __future__ import annotations

import bz2
import hashlib
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import cache, partial
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, NoReturn

import cv2
import lz4.frame  # type: ignore[import-untyped]
import mcap.stream_reader
import numpy as np
from mcap.reader import McapReader, make_reader
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader, anyreader
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag1.reader import Chunk, IndexData, Reader
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2 import storage_mcap as rosbag2_mcap
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

from conetl.files.atomic import temporary_path
from conetl.files.documents import library_errors, read_yaml
from conetl.model.errors import InputError
from conetl.model.rejections import RejectionReason
from conetl.readers.drives.bags.topics import CAMERA_INFO, TRANSFORMS, USED_TYPES
from conetl.readers.drives.pairs import PairError

METADATA = "metadata.yaml"
ROS1_SUFFIX = ".bag"

#: Channels, and the conversion to BGR. OpenCV names Bayer patterns from another pixel than ROS does (REP 118, cv_bridge).
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None), "8UC3": (3, None), "mono8": (1, None), "8UC1": (1, None), "rgb8": (3, cv2.COLOR_RGB2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR), "bgra8": (4, cv2.COLOR_BGRA2BGR), "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR), "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
}  # fmt: skip

#: Characters of a topic's name; DDS has no longer ones, and messages quote them.
MAX_TOPIC = 255
#: Largest chunk of messages, uncompressed; recorders make chunks of one to four megabytes, or of one message.
MAX_CHUNK_BYTES = 256 << 20
#: Messages of a bag; 90 bytes of memory each. Ten hours of a rig with a 200 Hz IMU have 8 million.
MAX_MESSAGES = 10_000_000
#: Decompressed bytes of chunks and bytes of messages per byte of the file; LZ4 reaches 255.
MAX_GROWTH = 256


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


def _whole_file(*_: object) -> NoReturn:
    raise ValueError(
        "its files are compressed as a whole: convert it with 'ros2 bag convert' to plain or compressed messages"
    )


# Both libraries allocate what a chunk states, or decompress as much as it makes.
_zstd, _lz4 = _limited(vars(rosbag2_reader)["zstd"].ZstdDecompressor), _limited(lz4.frame.LZ4FrameDecompressor)
rosbag2_mcap.DECOMPRESSORS.update(zstd=_zstd, lz4=_lz4)
vars(rosbag2_reader)["zstd"] = SimpleNamespace(decompress=_zstd, open=_whole_file)
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
    if (path / METADATA).is_file() and (files or any(path.glob("*.db3"))):
        return path
    files = files or sorted(path.glob(f"*{ROS1_SUFFIX}"))
    return files[0] if len(files) == 1 else None


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """The bag of `bag_files`. Raises InputError where it is truncated or damaged."""
    with ExitStack() as opened:
        with _bag_errors(path):
            if path.is_dir() or path.suffix == ROS1_SUFFIX:
                if (path / METADATA).is_file():
                    read_yaml(path / METADATA)  # within the limits, before rosbags builds it
                types = _ros_types() if path.is_dir() else _ros1_types()
                bag = _bag_of_rosbags(opened.enter_context(AnyReader([path], default_typestore=types)), path)
            else:
                bag = _bag_of_file(make_reader(opened.enter_context(path.open("rb")), validate_crcs=True), path)
        yield bag._replace(types={topic: kind for topic, kind in bag.types.items() if len(topic) <= MAX_TOPIC})


def _bag_errors(path: Path) -> AbstractContextManager[None]:
    """All errors of the bag libraries in a damaged file as InputError."""
    of_ros1 = path.suffix == ROS1_SUFFIX
    repair = f"'rosbag reindex {path.name}'" if of_ros1 else "'mcap recover' (MCAP) or 'ros2 bag reindex'"
    return library_errors(f"{path}: the bag cannot be read: it is damaged or cut off", hint=f". {repair} repairs it")


def _bag_of_rosbags(reader: AnyReader, path: Path) -> Bag:
    def messages(topics: Sequence[str]) -> Iterator[Message]:
        wanted = [c for c in reader.connections if c.topic in topics]
        with _bag_errors(path):
            for connection, at_ns, raw in reader.messages(wanted) if wanted else ():
                content = _decoded(reader.deserialize, raw, connection.msgtype)
                if connection.msgtype == CAMERA_INFO and not reader.is2 and content is not None:
                    # Under the names of ROS 2, which are in lower case.
                    content = SimpleNamespace(**{k if len(k) > 1 else k.lower(): v for k, v in vars(content).items()})
                yield Message(connection.topic, content, at_ns)

    ros = _ros_types() if reader.is2 else _ros1_types()
    types = {
        # From a ROS 1 bag only the definitions of these types are read.
        c.topic: _type_name(reader.typestore, c.msgtype, ros) if reader.is2 or c.msgtype in USED_TYPES else c.msgtype
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
    types = {
        channel.topic: _type_name(store, normalize_msgtype(summary.schemas[channel.schema_id].name), _ros_types())
        for channel in summary.channels.values()
        if channel.message_encoding == "cdr" and channel.schema_id in summary.schemas
    }
    indexed = bool(summary.chunk_indexes)

    def messages(topics: Sequence[str]) -> Iterator[Message]:
        wanted = [topic for topic in topics if topic in types]
        # Without an index the file is in the order of recording; to sort it, all of it would be kept in memory.
        with _bag_errors(path):
            for _, channel, message in reader.iter_messages(wanted, log_time_order=indexed) if wanted else ():
                content = _decoded(store.deserialize_cdr, message.data, types[channel.topic])
                yield Message(channel.topic, content, message.log_time)

    statistics = summary.statistics
    counts = {
        c.topic: statistics.channel_message_counts.get(c.id, 0) if statistics else 0 for c in summary.channels.values()
    }
    recorded_ns = (statistics.message_start_time, statistics.message_end_time) if statistics else (0, 0)
    return Bag(types, counts, recorded_ns, messages)


def _decoded(deserialize: Callable[[bytes, str], object], raw: bytes, kind: str) -> Any:
    """Fields of a message as attributes; None where its bytes do not match its type."""
    try:
        return deserialize(raw, kind)
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
def _ros_types() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def _ros1_types() -> Typestore:
    """Types of ROS 1, with the one of tf2 that rosbags has only for ROS 2."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register({TRANSFORMS: _ros_types().fielddefs[TRANSFORMS]})
    return store


def image_bytes(content: Any, name: str) -> bytes:
    """File bytes of a sensor_msgs CompressedImage (as they are) or Image (as PNG). Raises PairError."""
    data = np.asarray(content.data, dtype=np.uint8)
    if not hasattr(content, "encoding"):
        return data.tobytes()
    encoding = str(content.encoding)
    if encoding not in _ENCODINGS:
        raise PairError(
            RejectionReason.IMAGE_UNREADABLE,
            f"{name}: the encoding '{encoding}' is not supported; known: {', '.join(_ENCODINGS)}, and "
            "JPEG or PNG in a CompressedImage",
        )
    channels, code = _ENCODINGS[encoding]
    height, width, step = int(content.height), int(content.width), int(content.step)
    if height < 1 or step < width * channels or width < 1 or data.size < height * step:
        raise PairError(
            RejectionReason.IMAGE_TRUNCATED,
            f"{name}: {data.size} bytes are too few for {width} x {height} pixels of {encoding} in rows of {step} bytes",
        )
    rows = data[: height * step].reshape(height, step)[:, : width * channels]
    pixels: NDArray[np.uint8] = np.ascontiguousarray(rows.reshape(height, width, channels))
    image = pixels if code is None else cv2.cvtColor(pixels, code)
    done, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise PairError(RejectionReason.IMAGE_UNREADABLE, f"{name}: the image cannot be written as PNG")
    return bytes(encoded.tobytes())


def unpack(data: bytes, suffix: str, folder: Path) -> Path:
    """Path of the image in the folder, written unless it exists. Raises InputError where it cannot be written."""
    digest = hashlib.sha256(data).hexdigest()
    path = (folder / digest[:2] / f"{digest}{suffix}").absolute()
    free_space = "; free space or set CONETL_HOME to a folder with more"
    with library_errors(f"{path}: an image of the bag cannot be unpacked there", OSError, hint=free_space):
        if path.is_file() and path.read_bytes() == data:  # it may be damaged, for example by a power failure
            path.touch()  # in use: `old_images` checks its age
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = temporary_path(path)
        unfinished.write_bytes(data)
        unfinished.replace(path)
    return path
