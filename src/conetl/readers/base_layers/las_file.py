"""LAS, LAZ and COPC files, chunk by chunk: the memory needed is that of one chunk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import laspy
import lazrs  # type: ignore[import-untyped]
import numpy as np
from pyproj import CRS

from conetl.files.documents import MAX_SHOWN, input_errors
from conetl.model.errors import InputError
from conetl.readers.base_layers.point_tiles import Cloud

CHUNK_POINTS = 400_000
#: ASPRS classes of low and high noise.
_NOISE = (7, 18)
_PLAIN_SHADE = 170
_VLR_HEADER_BYTES, _EVLR_HEADER_BYTES = 54, 60
#: A chunk of compressed points begins with one that is not.
_CHUNK_BYTES = 20
#: Points of a chunk, which the decoder holds at once; most programs write 50,000.
_MAX_CHUNK_POINTS = 5_000_000
#: Layers of a chunk by point format, without one for each extra byte; older formats have none.
_LAYERS = {6: 9, 7: 10, 8: 11, 9: 10, 10: 12}


def read_las_header(path: Path) -> tuple[int, CRS | None]:
    """Number of points stated in the header, and the CRS of the file. Raises InputError."""
    _check_header(path)
    with _reading(path), laspy.open(path) as reader:
        header = reader.header
        numbers = np.concatenate([header.scales, header.offsets])
        if not np.isfinite(numbers).all() or not (np.asarray(header.scales) > 0).all():
            raise InputError(
                f"{path}: the header's scales {header.scales} and offsets {header.offsets} are not usable numbers"
            )
        if header.point_count == 0:
            raise InputError(f"{path}: the file has no points")
        if header.are_points_compressed:
            _check_chunks(path, header)
        try:
            crs = header.parse_crs()
        except Exception:  # of many types, from pyproj and laspy: the file has no usable CRS
            crs = None
        return int(header.point_count), crs


def las_chunks(path: Path, expected: int) -> Iterator[Cloud]:
    """All points in the file's own coordinates and units, without noise and withheld points. Raises InputError.

    A truncated or damaged file is an error after its good chunks: write nothing before the end.
    """
    read = 0
    brightest: float | None = None
    with _reading(path), laspy.open(path) as reader:
        for chunk in reader.chunk_iterator(CHUNK_POINTS):
            read += len(chunk)
            xyz = np.column_stack([np.asarray(chunk.x), np.asarray(chunk.y), np.asarray(chunk.z)])
            intensity = np.asarray(chunk.intensity, np.float64)
            if brightest is None:
                brightest = float(np.percentile(intensity, 98)) if len(intensity) else 0.0
            keep = ~np.isin(np.asarray(chunk.classification), _NOISE) & ~np.asarray(chunk.withheld, bool)
            shade = intensity / brightest * 255 if brightest > 0 else np.full(len(intensity), _PLAIN_SHADE)
            yield Cloud(xyz[keep], np.clip(np.rint(shade[keep]), 0, 255).astype(np.uint8))
    if read != expected:
        raise InputError(
            f"{path}: the header states {expected:,} points, the file has {read:,}. It is truncated or damaged: copy it again"
        )


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """All errors of the LAS libraries in a broken file become one InputError, panics of the Rust decoder included."""
    try:
        yield
    except (InputError, GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # pyo3's PanicException is not an Exception
        text = str(error)[:MAX_SHOWN]
        raise InputError(
            f"{path}: the points cannot be read ({text}). Expected a complete LAS or LAZ file; this one is truncated or damaged: "
            "copy it again"
        ) from error


def _laz_chunks(file: BinaryIO, points_at: int, size: int) -> int:
    """Number of chunks that the chunk table of a LAZ file states. It is found by a number before the points, else the last."""
    for at in (points_at, size - 8):
        file.seek(max(at, 0))
        table_at = int.from_bytes(file.read(8), "little")
        if points_at < table_at < size:
            file.seek(table_at + 4)
            return int.from_bytes(file.read(4), "little")
    return 0


def _check_chunks(path: Path, header: laspy.LasHeader) -> None:
    """Reject sizes of LAZ chunks and their layers that cannot be true: the decoder allocates them and aborts without memory."""
    vlr = lazrs.LazVlr(header.vlrs.get("LasZipVlr")[0].record_data)
    form = header.point_format
    layers = _LAYERS[form.id] + form.num_extra_bytes if form.id in _LAYERS else 0
    size, at = path.stat().st_size, header.offset_to_point_data + 8  # after the chunk table's offset
    with path.open("rb") as file:
        file.seek(header.offset_to_point_data)
        table = lazrs.read_chunk_table(file, vlr)
        for number, (points, chunk_bytes) in enumerate(table):
            file.seek(at + form.size + 4)  # after a point and the number of points
            stated = int(np.frombuffer(file.read(4 * layers), "<u4").sum(dtype=np.int64))
            at += chunk_bytes
            if points > _MAX_CHUNK_POINTS or vlr.item_size() != form.size or stated > chunk_bytes or at > size:
                raise InputError(
                    f"{path}: chunk {number + 1} of {len(table)} states {points:,} points of {vlr.item_size()} bytes, {stated:,} "
                    f"bytes of layers; expected at most {_MAX_CHUNK_POINTS:,} points of {form.size} bytes, layers of at most "
                    f"{chunk_bytes:,} bytes within the {size:,} of the file. It is damaged: copy it again"
                )


def _check_header(path: Path) -> None:
    """Reject a number of records or chunks that cannot be true: laspy would try to read as many, its decoder abort."""
    with input_errors(path), path.open("rb") as file:
        size, head = path.stat().st_size, file.read(247)
        chunks = _laz_chunks(file, int.from_bytes(head[96:100], "little"), size) if head[104:105] >= b"@" else 0
    if head[:4] != b"LASF":
        raise InputError(f"{path}: this is not a LAS or LAZ file (expected LASF at its beginning)")
    records = [
        ("records before the points", int.from_bytes(head[100:104], "little"), _VLR_HEADER_BYTES),
        ("chunks of points", chunks, _CHUNK_BYTES),
    ]
    if head[25:26] >= b"\4":  # of version 1.4 on
        records.append(("records after the points", int.from_bytes(head[243:247], "little"), _EVLR_HEADER_BYTES))
    for what, count, record_bytes in records:
        if count * record_bytes > size:
            raise InputError(
                f"{path}: the header states {count:,} {what}, which do not fit into {size:,} bytes. It is "
                "truncated or damaged: copy it again"
            )
