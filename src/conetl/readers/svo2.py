"""Recordings of ZED cameras (.svo2): their video copied into an MP4 file, packet by packet, without decoding it.

Stereolabs does not document the format. This follows what two readers of others found in their recordings, and reads no more
than both agree on (github.com/RadarML/open-svo2, docs/format.md, H.265; nes.is-a.dev/out/2025/svo2.html): MCAP with the topics

    svo_header                 JSON; `header` is base64 of 128 bytes that begin with width, height, serial number (uint32)
    Camera_SN*/side_by_side    a frame with both raw images, left first: two uint32, the second being the size of the stream
                               that follows (Annex B of H.264 or H.265), then 56 bytes about the frame; its time is the message's

Frames that were recorded as JPEG or PNG have another layout and are refused. The IMU is not used: it gives no positions.
"""

from __future__ import annotations

import base64
import json
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import av
from mcap.reader import McapReader, make_reader
from mcap.records import Message

from conetl.files.atomic import atomic_files
from conetl.files.documents import library_errors
from conetl.model.errors import InputError
from conetl.perception.video import MAX_FRAMES, VIDEO_SUFFIXES
from conetl.readers.drives.bag_messages import bag_errors
from conetl.readers.drives.formats import names_in
from conetl.readers.trajectories.times import clock_problem

SUFFIXES = frozenset({".svo", ".svo2"})
#: Export by Stereolabs' own tool, a sample of the ZED SDK.
EXPORT = "python svo_export.py --mode 0 --input_svo_file {0}.svo2 --output_avi_file {0}.avi"
_IMAGES, _HEADER = "/side_by_side", "svo_header"
_START_CODE, _SIZES = b"\0\0\0\1", struct.Struct("<II")
#: Units of a second of the time stamps in the MP4 file.
_UNITS = 1_000_000


class Svo2(NamedTuple):
    """Camera, length and start of a recording, as it states them."""

    serial: int | None
    """Serial number of the camera; its factory calibration is SN<serial>.conf."""
    frames: int
    start_ns: int | None
    """Time of the first frame, UTC; None where the camera's clock was not set."""


def svo2_of(root: Path) -> Path | None:
    """The recording in a folder without other videos; None if there is none. Raises InputError if there are several."""
    found = [root / name for name in names_in(root, SUFFIXES)]
    if not found or any(Path(name).stem != found[0].stem for name in names_in(root, VIDEO_SUFFIXES)):
        return None
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise InputError(f"{root}: there are several recordings ({names}): give each a folder of its own")
    return found[0]


def read_svo2(path: Path) -> Svo2:
    """Camera, frames and beginning of a recording. Raises InputError."""
    with _opened(path) as reader:
        topic, frames = _topic(reader, path)
        first = next(reader.iter_messages([topic]), None)
        if first is None:
            raise InputError(f"{path}: the recording has no images")
        start_ns = first[2].log_time
        header = next(reader.iter_messages([_HEADER]), None)
        serial = None if header is None else _serial(header[2].data)
    return Svo2(serial, frames, start_ns if clock_problem(start_ns) is None else None)


def copy_video(path: Path, target: Path) -> None:
    """Write the video of a recording as an MP4 file; times count from the first frame. Raises InputError."""
    with _opened(path) as reader, atomic_files(target) as (unfinished,):
        topic, _ = _topic(reader, path)
        with av.open(str(unfinished), "w", format="mp4") as output:
            stream = None
            start_ns = last = 0
            for number, (_, _, message) in enumerate(reader.iter_messages([topic])):
                data = _stream(message, path)
                if number >= MAX_FRAMES:
                    raise InputError(f"{path}: more than {MAX_FRAMES:,} frames: split the recording into several")
                if stream is None:
                    unknown = f"{path}: its first frame has no parameters of H.264 or H.265: {_export(path)}"
                    options = {"format_whitelist": "h264,hevc"}
                    with library_errors(unknown, av.FFmpegError), av.open(BytesIO(data), options=options) as probed:
                        codec, stream = probed.format.name, output.add_stream_from_template(probed.streams.video[0])
                    stream.time_base = Fraction(1, _UNITS)
                    start_ns, last = message.log_time, -1
                packet = av.Packet(data)
                last = max((message.log_time - start_ns) * _UNITS // 10**9, last + 1)
                packet.stream, packet.time_base = stream, Fraction(1, _UNITS)
                packet.pts = packet.dts = last
                packet.is_keyframe = number == 0 or _can_begin(data, codec)
                output.mux(packet)


@contextmanager
def _opened(path: Path) -> Iterator[McapReader]:
    if path.suffix.lower() != ".svo2":
        raise InputError(f"{path}: recordings of this format are not documented: {_export(path)}")
    with bag_errors(path), path.open("rb") as file:
        yield make_reader(file, validate_crcs=True)


def _export(path: Path) -> str:
    return f"export it with Stereolabs' own tool ({EXPORT.format(path.stem)})"


def _topic(reader: McapReader, path: Path) -> tuple[str, int]:
    """Topic of the images, and how many it has."""
    summary = reader.get_summary()
    channels = [] if summary is None else [c for c in summary.channels.values() if c.topic.endswith(_IMAGES)]
    if summary is None or len(channels) != 1:
        raise InputError(
            f"{path}: expected one topic Camera_SN.../side_by_side, found {len(channels)}: {_export(path)}"
        )
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    return channels[0].topic, counts.get(channels[0].id, 0)


def _serial(data: bytes) -> int | None:
    try:
        values: tuple[int, ...] = struct.unpack_from("<III", base64.b64decode(json.loads(data)["header"]))
    except (ValueError, KeyError, TypeError, RecursionError, struct.error):
        return None
    return values[2]


def _stream(message: Message, path: Path) -> bytes:
    """The part of H.264 or H.265 of one frame."""
    data = message.data
    size = _SIZES.unpack_from(data)[1] if len(data) > _SIZES.size else 0
    found = data[_SIZES.size : _SIZES.size + size]
    if len(found) != size or not found.startswith(_START_CODE):
        raise InputError(
            f"{path}: its frames are not H.264 or H.265 in the layout that conetl knows (the ZED SDK also records JPEG and PNG): "
            f"{_export(path)}"
        )
    return found


def _can_begin(data: bytes, codec: str) -> bool:
    """Whether decoding can begin with a frame (IDR of H.264, IRAP of H.265), by the first bytes of its units."""
    heads = {head[0] for head in re.findall(rb"\0\0\x01(?=(.))", data, re.DOTALL)}
    return any(16 <= head >> 1 & 63 <= 23 if codec == "hevc" else head & 31 == 5 for head in heads)
