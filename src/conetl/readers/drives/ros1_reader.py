"""ROS 1 bags within bounds: rosbags' reader, with limits on its index and on what is decompressed.

The index of a bag names messages by chunk and offset, and rosbags believes it: entries that overlap, or chunks that are named
often, cost more time and memory than the file has bytes. Here all of them together are at most as large as the file, and what
is read of them at most so many times larger.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator
from functools import partial
from itertools import pairwise
from operator import attrgetter
from pathlib import Path

from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import Chunk, IndexData, Reader

#: Messages of a bag; 90 bytes of memory each. Ten hours of a rig with a 200 Hz IMU have 8 million.
MAX_MESSAGES = 10_000_000
#: Decompressed bytes of chunks and bytes of messages per byte of the file; LZ4 reaches 255.
MAX_GROWTH = 256


class BoundedReader(Reader):
    """Reads the definitions of some message types only (others may have any), and chunks up to a size."""

    def __init__(self, path: Path, types: Collection[str], max_chunk_bytes: int) -> None:
        super().__init__(path)
        self._types, self._max_chunk_bytes = types, max_chunk_bytes
        self._file_bytes = path.stat().st_size
        self._index_bytes = self._chunk_bytes = 0
        self._left = MAX_GROWTH * self._file_bytes + max_chunk_bytes

    def read_connection(self) -> Connection:
        """Raises ReaderError."""
        found = super().read_connection()
        if found.msgtype in self._types:
            return found
        return found._replace(msgdef=MessageDefinition(MessageDefinitionFormat.NONE, ""), digest="")

    def read_chunk(self) -> Chunk:
        """Raises ReaderError, ValueError."""
        chunk = super().read_chunk()
        self._chunk_bytes += chunk.datasize
        if chunk.datasize > self._max_chunk_bytes:
            raise ValueError(f"a chunk is larger than {self._max_chunk_bytes >> 20} MB: record smaller chunks")
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
            raise ValueError("its index names messages twice")
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
            raise ValueError("its index names messages twice")
        for connection, time_ns, data in super().messages(connections, start, stop):
            if connection.id not in wanted:
                raise ValueError("its index names messages of other topics")
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
