"""The raw records of a drive into their tables, encoded by a thread while the server merges the drive's deltas.

Encoding 100,000 positions takes longer than loading them, and nearly as long as the merge, during which this process would only
wait. All of it goes through one connection in one transaction, which the thread never touches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from functools import partial
from itertools import chain
from typing import TypeVar
from uuid import UUID

from conetl.db.connection import Connection, CopyBlock, copy_block, encoded_block
from conetl.db.made_ahead import made_ahead
from conetl.db.map import columns as map_columns
from conetl.model.records import DriveRecords

#: Records of a block, and blocks that wait at most: some 100 MB of positions, which are the longest rows.
BLOCK_RECORDS = 25_000
BLOCKS_AHEAD = 12

R = TypeVar("R")


def records_encoded(drive_uuid: UUID, srid: int, records: DriveRecords) -> AbstractContextManager[Iterator[CopyBlock]]:
    """All raw records of a drive as blocks for `load_records`, encoded by a thread from now until the end of the block."""
    columns = map_columns
    blocks = chain(
        _blocks("conetl.frame_pair", records.drive.frame_pairs, partial(columns.frame_pair_columns, drive_uuid, srid)),
        _blocks("conetl.detection", records.detections, partial(columns.detection_columns, drive_uuid)),
        _blocks("conetl.stereo_match", records.matches, partial(columns.match_columns, drive_uuid)),
        _blocks("conetl.position", records.positions, partial(columns.position_columns, drive_uuid, srid)),
        _blocks("conetl.track", records.tracks, partial(columns.track_columns, drive_uuid, srid)),
        _blocks("conetl.track_member", records.tracks, partial(columns.track_member_columns, drive_uuid)),
    )
    return made_ahead(blocks, ahead=BLOCKS_AHEAD)


def load_records(conn: Connection, blocks: Iterator[CopyBlock]) -> None:
    """COPY all blocks, inside the open transaction."""
    for block in blocks:
        copy_block(conn, block)


def _blocks(
    table: str, records: Sequence[R], columns_of: Callable[[Sequence[R]], map_columns.Columns]
) -> Iterator[CopyBlock]:
    for start in range(0, len(records), BLOCK_RECORDS):
        yield encoded_block(table, columns_of(records[start : start + BLOCK_RECORDS]))
