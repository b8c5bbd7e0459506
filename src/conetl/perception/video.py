"""Video files (PyAV): what they hold without decoding it, and how their frames are named.

A frame is named like a file: `left.mp4#pts=51200`, with the frame's time stamp in the units of its stream; the half of a
side-by-side frame by the region of W3C Media Fragments, `&xywh=x,y,width,height` in pixels. `video_frames.py` reads frames.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import av
import numpy as np
from av.container import InputContainer
from av.stream import Disposition
from av.video.stream import VideoStream
from numpy.typing import NDArray

from conetl.model.errors import InputError
from conetl.model.rig import MAX_IMAGE_PIXELS, Side

Region = tuple[int, int, int, int]
"""x, y of the top-left corner, width, height in pixels."""
Layout = Literal["left-right", "right-left", "top-bottom", "bottom-top"]
"""Where left and right are in each frame of one file."""
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".ts"})
#: Nothing but files and containers: a playlist would make the library open other files and addresses.
_OPTIONS = {"protocol_whitelist": "file", "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts"}
#: Bytes between the position that an AVI file's index names and a frame.
_AVI_CHUNK_HEADER = 8
#: 18 hours at 30 Hz.
MAX_FRAMES = 2_000_000
_FRAGMENT = re.compile(
    r"^(?P<path>.+)#pts=(?P<pts>-?\d{1,18})(?:&xywh=(?P<region>\d{1,5}(?:,\d{1,5}){3}))?$", re.DOTALL
)


class FrameRef(NamedTuple):
    """One frame of a video file, or a region of it."""

    path: Path
    pts: int
    region: Region | None = None

    def __str__(self) -> str:
        region = f"&xywh={','.join(map(str, self.region))}" if self.region else ""
        return f"{self.path}#pts={self.pts}{region}"


class VideoIndex(NamedTuple):
    """What a video file holds, without its images."""

    path: Path
    width_px: int
    height_px: int
    time_base: Fraction
    """Seconds per unit of the time stamps."""
    pts: tuple[int, ...]
    """Of every frame, rising."""
    sha256s: tuple[bytes, ...]
    """Of the packet of every frame; empty where packets were not read for their hash."""
    created_at: datetime | None
    """As the container states it, UTC: mostly to the second, and often of a clock that nobody set."""

    def times_s(self) -> NDArray[np.float64]:
        """(N,) of every frame, from the beginning of the file's time scale."""
        return np.array([float(pts * self.time_base) for pts in self.pts])

    def sha256(self, number: int, region: Region | None = None) -> str:
        """Hash that identifies the content of frame `number`, or of a region of it; empty where packets have none."""
        return frame_sha256(self.sha256s[number], region) if self.sha256s else ""


def frame_of(path: str | Path) -> FrameRef | None:
    """The frame that a path names; None for a path of a file."""
    found = _FRAGMENT.match(str(path))
    if found is None or Path(found["path"]).suffix.lower() not in VIDEO_SUFFIXES:
        return None
    x, y, width, height = (int(word) for word in (found["region"] or "0,0,0,0").split(","))
    return FrameRef(Path(found["path"]), int(found["pts"]), (x, y, width, height) if found["region"] else None)


def frame_sha256(packet_sha256: bytes, region: Region | None) -> str:
    """Hash of a frame, or of a region of it, by its packet's."""
    return packet_sha256.hex() if region is None else hashlib.sha256(packet_sha256 + repr(region).encode()).hexdigest()


def region_of(video: VideoIndex, layout: Layout | None, side: Side) -> Region | None:
    """The half of each frame that is the image of one side; None: all of it."""
    if layout is None:
        return None
    second = (side == "right") == (layout in ("left-right", "top-bottom"))
    if layout in ("left-right", "right-left"):
        width = video.width_px // 2
        return (width if second else 0, 0, width, video.height_px)
    height = video.height_px // 2
    return (0, height if second else 0, video.width_px, height)


def index_video(path: Path, *, hashed: bool = True) -> VideoIndex:
    """The frames of a video file. Nothing is decoded, but the whole file is read.

    hashed: with the hash of every packet. Raises InputError where the file is not a video, ends before its index, or has no
    usable time stamps.
    """
    with open_video(path) as container:
        stream = video_stream(container)
        found: dict[int, bytes] = {}
        try:
            for packet in packets_of(container):
                pts = packet.pts if packet.pts is not None else packet.dts
                if pts is None or packet.is_discard or not packet.size:
                    continue
                found[pts] = packet_sha256(packet, pts) if hashed else b""
                if len(found) > MAX_FRAMES:
                    raise InputError(f"{path}: more than {MAX_FRAMES:,} frames: split it into several drives")
        except av.FFmpegError as error:
            raise InputError(
                f"{path}: the video cannot be read to its end ({error.strerror}): copy it again"
            ) from error
        base, (width, height) = stream.time_base, _size(stream)
        created = container.metadata.get("creation_time")
    if not found or base is None:
        raise InputError(f"{path}: the video has no frames with time stamps; record it into MP4 or MKV")
    if width < 1 or height < 1 or width * height > MAX_IMAGE_PIXELS:
        raise InputError(f"{path}: frames of {width} x {height} pixels are not supported")
    order = sorted(found)
    sha256s = tuple(found[pts] for pts in order) if hashed else ()
    return VideoIndex(path, width, height, Fraction(base), tuple(order), sha256s, _created(created))


class VideoFacts(NamedTuple):
    """What the header of a video file states."""

    frames: int
    duration_s: float
    width_px: int
    height_px: int


def video_facts(path: Path) -> VideoFacts:
    """Number of frames, duration and size by the header alone. Raises InputError."""
    with open_video(path) as container:
        stream = video_stream(container)
        duration_s = max(float((container.duration or 0) / av.time_base), 0.0)
        frames = stream.frames or round(duration_s * float(stream.average_rate or 0))
        return VideoFacts(int(frames), duration_s, *_size(stream))


def open_video(path: Path) -> InputContainer:
    """An open video file, to be closed. Raises InputError."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: this is not a file; name a video")  # a pipe would wait for its other end
    try:
        container = av.open(str(path), options=_OPTIONS, metadata_errors="replace")
    except (av.FFmpegError, OSError) as error:
        raise InputError(
            f"{path}: the video cannot be opened ({error.strerror or error}). A recording that was cut off before its index was "
            "written (MP4: 'moov atom not found') needs the recorder's repair tool; record MKV to avoid that"
        ) from error
    streams = _images_in_time(container)
    if len(streams) == 1 and streams[0].codec_context is not None:
        return container
    container.close()
    if not streams:
        raise InputError(f"{path}: the file has no video stream")
    if len(streams) > 1:
        raise InputError(
            f"{path}: the file has {len(streams)} video streams, expected one: write each to a file of its own ('ffmpeg -i "
            f"{path.name} -map 0:v:0 -c copy left.mp4', and 0:v:1 for the other)"
        )
    raise InputError(f"{path}: the codec of the video is unknown: convert it to H.264 or Motion JPEG")


def _images_in_time(container: InputContainer) -> list[VideoStream]:
    """The video streams that are not cover art."""
    return [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]


def video_stream(container: InputContainer) -> VideoStream:
    """The stream of an open file."""
    return _images_in_time(container)[0]


def packets_of(container: InputContainer) -> Iterator[av.Packet[Any]]:
    """Packets of the stream from the current position on. Raises av.FFmpegError.

    Those of an AVI file have no time stamps: where the file is damaged, the library does not count the frames that it skips.
    Their positions in the file's index state the time.
    """
    stream = video_stream(container)
    is_avi = container.format.name == "avi"
    times = {entry.pos + _AVI_CHUNK_HEADER: entry.timestamp for entry in stream.index_entries} if is_avi else {}
    for packet in container.demux(stream):
        if packet.pos in times and packet.dts is not None:
            skipped = times[packet.pos] - packet.dts
            packet.dts += skipped
            packet.pts = None if packet.pts is None else packet.pts + skipped
        yield packet


def _size(stream: VideoStream) -> tuple[int, int]:
    """Width and height in pixels."""
    return int(stream.codec_context.width), int(stream.codec_context.height)


def packet_sha256(packet: av.Packet[Any], pts: int) -> bytes:
    """Hash of one frame's packet. Equal key frames are equal images; other packets refer to the frames before them."""
    data = hashlib.sha256(memoryview(packet))
    if not packet.is_keyframe:
        data.update(str(pts).encode())
    return data.digest()


def _created(text: str | None) -> datetime | None:
    try:
        created = datetime.fromisoformat(text or "")
        return created.astimezone(UTC) if created.tzinfo else created.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        return None
