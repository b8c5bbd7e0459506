"""ROS 1 bags within bounds: rosbags' reader, with limits on its index, and each chunk decompressed once.

The index of a bag names messages by chunk and offset, and rosbags believes it: entries that overlap, or chunks that are named
often, cost more time and memory than the file has bytes. Here all of them together are at most as large as the file.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from io import BytesIO
from operator import attrgetter
from pathlib import Path

from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import Chunk, Header, IndexData, Reader, RecordType, read_bytes, read_uint32

#: Messages of a bag; 90 bytes of memory each. Ten hours of a rig with a 200 Hz IMU have 8 million.
MAX_MESSAGES = 10_000_000
#: Decompressed bytes of all chunks per byte of the file; LZ4 reaches 255.
MAX_GROWTH = 256


class BoundedReader(Reader):
    """Reads the definitions of some message types only (others may have any), and chunks up to a size."""

    def __init__(self, path: Path, types: Collection[str], max_chunk_bytes: int) -> None:
        super().__init__(path)
        self._types, self._max_chunk_bytes = types, max_chunk_bytes
        self._file_bytes = path.stat().st_size
        self._index_bytes = self._chunk_bytes = 0

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
        return chunk

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

    def messages(  # type: ignore[override]  # a generator is an iterator
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages in the order of the file, which is that of recording: each chunk is read once. start, stop: not used.

        Raises ReaderError, ValueError.
        """
        assert self.bio
        wanted = {connection.id: connection for connection in connections}
        entries = sorted((e for i in wanted for e in self.indexes[i]), key=attrgetter("chunk_pos", "offset"))
        left = MAX_GROWTH * self._file_bytes + self._max_chunk_bytes
        chunk, position, end = BytesIO(), -1, 0
        for entry in entries:
            if entry.chunk_pos != position:
                position, end = entry.chunk_pos, 0
                named = self.chunks[position]
                self.bio.seek(named.datapos)
                plain = named.decompressor(read_bytes(self.bio, named.datasize))
                left -= len(plain)
                if left < 0:
                    raise ValueError(f"it grows to more than {MAX_GROWTH} times its size")
                chunk = BytesIO(plain)
            if entry.offset < end:
                raise ValueError("its index names messages twice")
            chunk.seek(entry.offset)
            header = Header.read(chunk)
            while header.get_uint8("op") == RecordType.CONNECTION:
                chunk.seek(read_uint32(chunk), 1)
                header = Header.read(chunk)
            if header.get_uint8("op") != RecordType.MSGDATA:
                raise ValueError("its index does not point to messages")
            data = read_bytes(chunk, read_uint32(chunk))
            end = chunk.tell()
            connection = wanted.get(header.get_uint32("conn"))
            if connection is None:
                raise ValueError("its index names messages of other topics")
            yield connection, entry.time, data
