"""Frames of video files (PyAV): the index of a file without decoding it, and single frames by their time stamp.

A frame is named like a file: `left.mp4#pts=51200`, with the frame's time stamp in the units of its stream; the half of a
side-by-side frame by the region of W3C Media Fragments, `&xywh=x,y,width,height` in pixels. Frames are decoded when they are
read and never written to disk. Rotation tags are not applied: calibrations are for the pixels as stored.
"""

from __future__ import annotations

import hashlib
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import av
import numpy as np
from av.container import InputContainer
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation, VideoReformatter
from av.video.stream import VideoStream
from numpy.typing import NDArray

from conetl.model.errors import InputError, StorageError
from conetl.model.records import MAX_IMAGE_PIXELS, Side
from conetl.model.rejections import RejectionReason
from conetl.perception.images import ImageFileError

Image = NDArray[np.uint8]
Region = tuple[int, int, int, int]
"""x, y of the top-left corner, width, height in pixels."""
Layout = Literal["left-right", "right-left", "top-bottom", "bottom-top"]
"""Where left and right are in each frame of one file."""
LAYOUTS: tuple[Layout, ...] = get_args(Layout)

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".mkv", ".avi", ".ts"})
#: Nothing but files and containers: a playlist would make the library open other files and addresses.
_OPTIONS = {"protocol_whitelist": "file", "format_whitelist": "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts"}
#: 18 hours at 30 Hz.
MAX_FRAMES = 2_000_000
#: Decoders that stay open between two reads, and bytes of decoded frames that stay in memory: searches read the middle of five
#: pairs first, and odometry and detector read the same pairs at about the same time.
_MAX_DECODERS, _KEPT_BYTES = 8, 256 * 2**20
#: Without these the library rounds down, by more than one grey level.
_EXACT = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
_reformatters: list[VideoReformatter] = []
_FRAGMENT = re.compile(
    r"^(?P<path>.+)#pts=(?P<pts>-?\d{1,18})(?:&xywh=(?P<region>\d{1,5}(?:,\d{1,5}){3}))?$", re.DOTALL
)


class Frame(NamedTuple):
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
    codec: str
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


def frame_of(path: str | Path) -> Frame | None:
    """The frame that a path names; None for a path of a file."""
    found = _FRAGMENT.match(str(path))
    if found is None or Path(found["path"]).suffix.lower() not in VIDEO_SUFFIXES:
        return None
    x, y, width, height = (int(word) for word in (found["region"] or "0,0,0,0").split(","))
    return Frame(Path(found["path"]), int(found["pts"]), (x, y, width, height) if found["region"] else None)


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

    hashed: with the hash of every packet. Raises InputError where the file is no video, is cut off before its index, or has no
    usable time stamps.
    """
    with _opened(path) as container:
        stream = _stream(container)
        found: dict[int, bytes] = {}
        try:
            for packet in container.demux(stream):
                pts = packet.pts if packet.pts is not None else packet.dts
                if pts is None or packet.is_discard or not packet.size:
                    continue
                found[pts] = _packet_sha256(packet, pts) if hashed else b""
                if len(found) > MAX_FRAMES:
                    raise InputError(f"{path}: more than {MAX_FRAMES:,} frames: cut the recording into several drives")
        except av.FFmpegError as error:
            raise InputError(
                f"{path}: the video cannot be read to its end ({error.strerror}): copy it again"
            ) from error
        codec, base, (width, height) = _codec_name(stream), stream.time_base, _size(stream)
        created = container.metadata.get("creation_time")
    if not found or base is None:
        raise InputError(f"{path}: the video has no frames with time stamps; record it into MP4 or MKV")
    if width < 1 or height < 1 or width * height > MAX_IMAGE_PIXELS:
        raise InputError(f"{path}: frames of {width} x {height} pixels are not supported")
    order = sorted(found)
    sha256s = tuple(found[pts] for pts in order) if hashed else ()
    return VideoIndex(path, codec, width, height, Fraction(base), tuple(order), sha256s, _created(created))


class VideoFacts(NamedTuple):
    """What the header of a video file states."""

    frames: int
    duration_s: float
    width_px: int
    height_px: int


def video_facts(path: Path) -> VideoFacts:
    """Number of frames, duration and size by the header alone. Raises InputError."""
    with _opened(path) as container:
        stream = _stream(container)
        duration_s = max(float((container.duration or 0) / av.time_base), 0.0)
        frames = stream.frames or round(duration_s * float(stream.average_rate or 0))
        return VideoFacts(int(frames), duration_s, *_size(stream))


def read_frame(frame: Frame, sha256: str = "", *, grey: bool = False) -> Image:
    """A frame as (height, width, 3) uint8 in blue, green, red order; grey: (height, width) of its brightness.

    sha256: of `VideoIndex.sha256`, when its drive was read; empty: not compared. Raises ImageFileError where the frame is not
    there or cannot be decoded, StorageError where the file changed since.
    """
    found, packet_sha256 = _decoders.read(frame)
    if sha256 and frame_sha256(packet_sha256, frame.region) != sha256:
        raise StorageError(
            f"{frame.path}: the video changed while it was worked on. Run the same command again when nobody writes to the "
            "drive. Nothing was written."
        )
    image = _pixels(found, grey)
    if frame.region is None:
        return image
    x, y, width, height = frame.region
    return np.ascontiguousarray(image[y : y + height, x : x + width])


def frames_between(path: Path, first_pts: int, last_pts: int, *, grey: bool = False) -> Iterator[tuple[int, Image]]:
    """Frames of a file in the order of their time stamps, from the first to the last of these. Raises ImageFileError."""
    decoder = _Decoder(_File(path, 0, 0))
    try:
        decoder.seek(first_pts)
        for pts, frame in decoder.decoded():
            if pts > last_pts:
                break
            if pts >= first_pts:
                yield pts, _pixels(frame, grey)
    except av.FFmpegError as error:
        raise ImageFileError(
            RejectionReason.IMAGE_UNREADABLE, f"{path}: cannot be decoded ({error.strerror}): copy the video again"
        ) from error
    finally:
        decoder.close()


def _pixels(frame: VideoFrame, grey: bool) -> Image:
    """(height, width, 3) in blue, green, red order or (height, width), in the range and colour space that the file states."""
    # A frame's own reformatter is not safe where two threads read the same frame. One with threads of its own, or one that is
    # freed with its thread, would hang a process that is forked from this one: they are kept, each used by one thread at a time.
    try:
        own = _reformatters.pop()
    except IndexError:
        own = VideoReformatter()
    image = own.reformat(frame, format="gray" if grey else "bgr24", interpolation=_EXACT, threads=1).to_ndarray()
    _reformatters.append(own)
    return np.asarray(image, dtype=np.uint8)


# --------------------------------------------------------------------------- decoders


class _File(NamedTuple):
    """A file as it is now."""

    path: Path
    size: int
    mtime_ns: int


class _Decoded(NamedTuple):
    frame: VideoFrame
    packet_sha256: bytes


class _Decoder:
    """One open file, decoded from where it stands on."""

    def __init__(self, file: _File) -> None:
        self.file = file
        try:
            self._container = _open(file.path)
        except InputError as error:
            raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, str(error)) from error
        self._stream = _stream(self._container)
        self._stream.codec_context.thread_count = 1  # workers keep all cores busy
        self._stream.codec_context.options = {
            "max_pixels": str(MAX_IMAGE_PIXELS),
            "err_detect": "explode",
        }  # of later frames, too
        self._packets: dict[int, bytes] = {}
        self._frames = self.decoded()
        self.at: int | None = None
        """Time stamp of the last frame that was decoded."""
        self.thread = threading.current_thread()
        """The last one that used it."""

    def decoded(self) -> Iterator[tuple[int, VideoFrame]]:
        """Frames and their time stamps from here on, without damaged ones.

        The decoder fills what is damaged from the frames before it, and all frames up to the next key frame build on that.
        """
        damaged = False
        for packet in self._container.demux(self._stream):
            pts = packet.pts if packet.pts is not None else packet.dts
            if pts is not None and packet.size:
                self._packets[pts] = _packet_sha256(packet, pts)
            try:
                frames = packet.decode()
            except av.FFmpegError:
                damaged = True
                continue
            for frame in frames:
                damaged = frame.is_corrupt or (damaged and not frame.key_frame)
                if not damaged and frame.pts is not None:
                    yield frame.pts, frame

    def seek(self, pts: int) -> None:
        """Go to the last key frame that is not after a time stamp."""
        self._container.seek(pts, stream=self._stream, backward=True)
        self._packets.clear()
        self._frames, self.at = self.decoded(), None

    def leads_to(self, pts: int) -> bool:
        """Whether a frame is reached from here without a detour: there is no key frame on the way."""
        if self.at is None or self.at >= pts:
            return False
        entries = self._stream.index_entries
        k = entries.search_timestamp(pts, backward=True) if len(entries) else -1
        return k >= 0 and entries[k].timestamp <= self.at

    def forward(self, pts: int, keep: Callable[[int, _Decoded], None]) -> bool:
        """Decode up to a frame; False where the first one is after it. keep: called for every frame on the way."""
        if not self.leads_to(pts):
            self.seek(pts)
        first_pts = None
        for at, frame in self._frames:
            first_pts = at if first_pts is None else first_pts
            keep(at, _Decoded(frame, self._packets.pop(at, b"")))
            self.at = at
            if at >= pts:
                break
        return first_pts is None or first_pts <= pts

    def close(self) -> None:
        self._container.close()


class _Decoders:
    """Open decoders, each of one thread, and the frames that were decoded last, of all threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[_Decoder] = []
        self._kept: OrderedDict[tuple[_File, int], _Decoded] = OrderedDict()
        self._kept_bytes = 0

    def read(self, frame: Frame) -> _Decoded:
        """A decoded frame. Raises ImageFileError."""
        try:
            found = frame.path.stat()
        except OSError as error:
            raise ImageFileError(RejectionReason.IMAGE_MISSING, f"{frame.path}: {error.strerror}") from error
        file = _File(frame.path, found.st_size, found.st_mtime_ns)
        key = file, frame.pts
        if (kept := self._recall(key)) is not None:
            return kept
        decoder = self._take(file, frame.pts) or _Decoder(file)

        def keep(pts: int, decoded: _Decoded) -> None:
            self._keep((file, pts), decoded)

        try:
            if not decoder.forward(frame.pts, keep):
                decoder.seek(0)  # frames that are shown before their key frame need the one before it
                decoder.forward(frame.pts, keep)
        except av.FFmpegError as error:
            decoder.close()
            raise ImageFileError(
                RejectionReason.IMAGE_UNREADABLE, f"{frame}: cannot be decoded ({error.strerror}): copy the video again"
            ) from error
        self._give_back(decoder)
        if (kept := self._recall(key)) is None:
            raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, f"{frame}: the frame is damaged or missing")
        return kept

    def _recall(self, key: tuple[_File, int]) -> _Decoded | None:
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def _keep(self, key: tuple[_File, int], decoded: _Decoded) -> None:
        with self._lock:
            if key not in self._kept:
                self._kept[key] = decoded
                self._kept_bytes += _bytes_of(decoded.frame)
            while self._kept_bytes > _KEPT_BYTES and len(self._kept) > 1:
                self._kept_bytes -= _bytes_of(self._kept.popitem(last=False)[1].frame)

    def _take(self, file: _File, pts: int) -> _Decoder | None:
        """The decoder of this thread (or of one that ended) that is nearest before a frame, else any other of the file."""
        with self._lock:
            me = threading.current_thread()
            own = [d for d in self._idle if d.file == file and (d.thread is me or not d.thread.is_alive())]
            before = [d for d in own if d.leads_to(pts)]
            found = max(before, key=lambda d: d.at or 0) if before else own[0] if own else None
            if found is not None:
                self._idle.remove(found)
                found.thread = me
            return found

    def _give_back(self, decoder: _Decoder) -> None:
        with self._lock:
            self._idle.append(decoder)
            old = self._idle.pop(0) if len(self._idle) > _MAX_DECODERS else None
        if old is not None:
            old.close()


def _bytes_of(frame: VideoFrame) -> int:
    return sum(plane.buffer_size for plane in frame.planes)


_decoders = _Decoders()


@contextmanager
def _opened(path: Path) -> Iterator[InputContainer]:
    container = _open(path)
    try:
        yield container
    finally:
        container.close()


def _open(path: Path) -> InputContainer:
    """An open video file. Raises InputError."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: this is no file")  # a pipe would wait for its other end
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
    """The video streams that are no cover art."""
    return [s for s in container.streams.video if not s.disposition & Disposition.attached_pic]


def _stream(container: InputContainer) -> VideoStream:
    return _images_in_time(container)[0]


def _codec_name(stream: VideoStream) -> str:
    return str(stream.codec_context.name)


def _size(stream: VideoStream) -> tuple[int, int]:
    """Width and height in pixels."""
    return int(stream.codec_context.width), int(stream.codec_context.height)


def _packet_sha256(packet: av.Packet[Any], pts: int) -> bytes:
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
