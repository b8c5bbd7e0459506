"""Frames of video files, decoded when they are read and never written to disk.

Rotation tags are not applied: calibrations are for the pixels as stored.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import av
import cv2
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import Interpolation, VideoReformatter
from cachetools import LRUCache

from conetl.model.arrays import Image
from conetl.model.errors import InputError, StorageError
from conetl.model.rejections import RejectionReason
from conetl.model.rig import MAX_IMAGE_PIXELS
from conetl.perception.images import ImageFileError
from conetl.perception.video import (
    FrameRef,
    Region,
    frame_sha256,
    index_video,
    open_video,
    packet_sha256,
    packets_of,
    video_stream,
)

#: Decoders that stay open between two reads, and bytes of decoded frames that stay in memory: searches read the middle of five
#: pairs first, and odometry and detector read the same pairs at about the same time.
_MAX_DECODERS, _KEPT_BYTES = 8, 256 * 2**20
#: Up to here frames are decoded one after another, whether or not a key frame is on the way.
_NEAR_S = 0.5
#: Without these the library rounds down, by more than one grey level.
_EXACT = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT


def read_frame(frame: FrameRef, sha256: str = "", *, grey: bool = False) -> Image:
    """A frame as (height, width, 3) uint8 in blue, green, red order; grey: (height, width) of its brightness.

    sha256: of `VideoIndex.sha256`, when its drive was read; empty: not compared. Raises ImageFileError where the frame is not
    there or cannot be decoded, StorageError where the file changed since.
    """
    try:
        decoded = _decoders.read(frame)
        if sha256 and frame_sha256(decoded.packet_sha256, frame.region) != sha256:
            raise _not_decoded(frame)
        return _pixels(decoded.frame, frame.region, grey=grey)
    except ImageFileError as error:
        if sha256 and sha256 not in _frames_in(frame.path, frame.region):
            raise StorageError(
                f"{frame.path}: the video changed while conetl read it ({error}). Run the same command again when nothing writes "
                "to the drive. Nothing was written."
            ) from error
        raise


def _not_decoded(frame: FrameRef) -> ImageFileError:
    return ImageFileError(
        RejectionReason.IMAGE_UNREADABLE, f"{frame}: the frame is damaged or missing: copy the video again"
    )


def _frames_in(path: Path, region: Region | None) -> frozenset[str]:
    """Hashes of the frames of a video as it is now; none where it cannot be read."""
    try:
        found = path.stat()
        return _hashes_of(_File(path, found.st_size, found.st_mtime_ns), region)
    except (OSError, InputError):
        return frozenset()


def frames_between(path: Path, first_pts: int, last_pts: int) -> Iterator[tuple[int, Image]]:
    """Brightness (height, width) of the frames from one time stamp to another, in their order. Raises ImageFileError."""
    decoder = _Decoder(_File(path, 0, 0))
    try:
        decoder.seek(first_pts)
        for pts, frame in decoder.frames:
            if pts > last_pts:
                break
            if pts >= first_pts:
                yield pts, _pixels(frame, None, grey=True)
    except av.FFmpegError as error:
        raise ImageFileError(
            RejectionReason.IMAGE_UNREADABLE, f"{path}: cannot be decoded ({error.strerror}): copy the video again"
        ) from error
    finally:
        decoder.close()


def frame_pixels(frame: VideoFrame) -> Image:
    """A decoded frame as (height, width, 3) uint8 in blue, green, red order. Raises ImageFileError."""
    if frame.width * frame.height > MAX_IMAGE_PIXELS:
        raise ImageFileError(
            RejectionReason.IMAGE_WRONG_SIZE, f"a frame of {frame.width} x {frame.height} pixels is too large"
        )
    return _pixels(frame, None, grey=False)


def _pixels(frame: VideoFrame, region: Region | None, *, grey: bool) -> Image:
    """(height, width, 3) in blue, green, red order or (height, width).

    The library converts by the range, colour space and location of colour samples that the file states.
    """
    x, y, width, height = region or (0, 0, frame.width, frame.height)
    if x + width > frame.width or y + height > frame.height:
        raise ImageFileError(
            RejectionReason.IMAGE_WRONG_SIZE,
            f"a frame of {frame.width} x {frame.height} pixels has no region {x},{y},{width},{height}: the video changes size",
        )
    image = (_converted if region is None else _converted_once)(frame, grey=grey)[y : y + height, x : x + width]
    return image.copy() if grey else np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2BGR), dtype=np.uint8)


def _converted(frame: VideoFrame, *, grey: bool) -> Image:
    """The brightness (height, width) of a frame, or its red, green and blue (height, width, 3)."""
    # A frame's own reformatter is not safe where two threads read the same frame; one with threads of its own, or one that is
    # freed with its thread, would hang a process that is forked from this one.
    converted = VideoReformatter().reformat(frame, format="gray" if grey else "gbrp", interpolation=_EXACT, threads=1)
    return np.asarray(converted.to_ndarray(), dtype=np.uint8)


#: Frames with both images are read for one and then for the other.
_converted_once = lru_cache(maxsize=4)(_converted)


# --------------------------------------------------------------------------- decoders


class _File(NamedTuple):
    """A file as it is now."""

    path: Path
    size: int
    mtime_ns: int


@lru_cache(maxsize=4)
def _hashes_of(file: _File, region: Region | None) -> frozenset[str]:
    return frozenset(frame_sha256(packet, region) for packet in index_video(file.path).sha256s)


class _Decoded(NamedTuple):
    frame: VideoFrame
    packet_sha256: bytes


class _Decoder:
    """One open file and its position in it."""

    def __init__(self, file: _File) -> None:
        self.file = file
        self._container: InputContainer | None = None
        self.at: int | None = None
        """Time stamp of the last frame that was decoded; None: it is not known where it will go on."""
        self.thread = threading.current_thread()
        """The last one that used it."""

    def _open(self) -> InputContainer:
        """The file, which is opened when it is first needed. Raises ImageFileError."""
        if self._container is not None:
            return self._container
        try:
            container = open_video(self.file.path)
        except InputError as error:
            raise ImageFileError(RejectionReason.IMAGE_UNREADABLE, str(error)) from error
        self._container, self._stream = container, video_stream(container)
        self._stream.codec_context.thread_count = 1  # workers keep all cores busy; several miss damage
        self._stream.codec_context.options = {
            "max_pixels": str(MAX_IMAGE_PIXELS),
            "err_detect": "explode",
        }  # of later frames, too
        self._packets: dict[int, bytes] = {}
        self._base = float(self._stream.time_base or 0)
        return container

    def _decoded(self) -> Iterator[tuple[int, VideoFrame]]:
        """Frames and their time stamps from the current position on, without damaged ones.

        The decoder fills damaged areas from the frames before, and all frames up to the next key frame build on that.
        """
        damaged = False
        for packet in packets_of(self._open()):
            pts = packet.pts if packet.pts is not None else packet.dts
            if pts is not None and packet.size:
                self._packets[pts] = packet_sha256(packet, pts)
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
        """Go to the last key frame from which the frame can be decoded."""
        first, container = None, self._open()
        for start in (pts, self._key_frame(pts) - 1, 0):
            container.seek(start, stream=self._stream, backward=True)
            self._packets.clear()
            self.frames: Iterator[tuple[int, VideoFrame]] = self._decoded()
            # Files list when a key frame is decoded; frames that are shown before it may come after it, and need the one before.
            first = next(self.frames, None)
            if first is None or first[0] <= pts:
                break
        self.frames = chain([] if first is None else [first], self.frames)

    def _key_frame(self, pts: int) -> int:
        """When the last key frame before a time stamp is decoded, or that time stamp if the file does not state it."""
        entries = self._stream.index_entries
        k = entries.search_timestamp(pts, backward=True) if len(entries) else -1
        return entries[k].timestamp if k >= 0 else pts

    def can_reach(self, pts: int) -> bool:
        """Whether it is cheaper to decode on to a frame than to seek: it is near, or no key frame lies between."""
        if self.at is None or self.at >= pts:
            return False
        return (pts - self.at) * self._base <= _NEAR_S or self._key_frame(pts) <= self.at

    def decode_until(self, pts: int, keep: Callable[[int, _Decoded], None]) -> None:
        """Decode up to a frame. keep: called for every frame on the way."""
        if not self.can_reach(pts):
            self.at = None
            self.seek(pts)
        for at, frame in self.frames:
            keep(at, _Decoded(frame, self._packets.pop(at, b"")))
            self.at = at
            if at >= pts:
                break

    def close(self) -> None:
        if self._container is not None:
            self._container.close()


class _Decoders:
    """Open decoders, each used by one thread at a time, and the frames that any of them decoded last."""

    def __init__(self) -> None:
        self._reset()

    def _reset(self) -> None:
        """Start without open decoders and cached frames."""
        self._changed = threading.Condition()
        """A frame was decoded, or a decoder is not used any more."""
        self._idle: list[_Decoder] = []
        self._busy: list[_Decoder] = []
        self._kept: LRUCache[tuple[_File, int], _Decoded] = LRUCache(_KEPT_BYTES, getsizeof=_bytes_of)
        self._lost: dict[_File, list[range]] = {}
        """Time stamps of frames that cannot be decoded: to find out takes all frames up to the next key frame."""

    def read(self, frame: FrameRef) -> _Decoded:
        """A decoded frame. Raises ImageFileError."""
        try:
            found = frame.path.stat()
        except OSError as error:
            raise ImageFileError(RejectionReason.IMAGE_MISSING, f"{frame.path}: {error.strerror}") from error
        file = _File(frame.path, found.st_size, found.st_mtime_ns)
        if any(frame.pts in part for part in self._lost.get(file, ())):
            raise _not_decoded(frame)
        decoder = self._acquire(file, frame.pts)
        if isinstance(decoder, _Decoded):
            return decoder
        wanted: list[_Decoded] = []

        def keep(pts: int, decoded: _Decoded) -> None:
            self._keep((file, pts), decoded)
            if pts == frame.pts:  # what is kept may be dropped again while other threads read large frames
                wanted.append(decoded)

        works = False
        try:
            decoder.decode_until(frame.pts, keep)
            works = True
            if not wanted:
                reached = 2**63 if decoder.at is None or decoder.at < frame.pts else decoder.at
                self._lost.setdefault(file, []).append(range(frame.pts, reached))
        except av.FFmpegError as error:
            raise ImageFileError(
                RejectionReason.IMAGE_UNREADABLE, f"{frame}: cannot be decoded ({error.strerror}): copy the video again"
            ) from error
        finally:
            self._release(decoder, works=works)
        if not wanted:
            raise _not_decoded(frame)
        return wanted[-1]

    def _acquire(self, file: _File, pts: int) -> _Decoded | _Decoder:
        """The frame if it is in memory; else the nearest decoder before it, another one of this thread (or of one that ended), or
        a new one.

        If another thread uses the nearest decoder, wait for it: with distant key frames, or both images in one file, it is
        decoding what is needed here, or can be continued from there.
        """
        with self._changed:
            while (kept := self._kept.get((file, pts))) is None:
                busy = [d for d in self._busy if d.file == file and (d.at is None or d.at < pts)]
                idle = [d for d in self._idle if d.file == file]
                found = max((d for d in idle if d.can_reach(pts)), key=_reached, default=None)
                if not busy or (found is not None and _reached(found) > max(map(_reached, busy))):
                    break
                self._changed.wait()
            if kept is not None:
                return kept
            me = threading.current_thread()
            own = (d for d in idle if d.thread is me or not d.thread.is_alive())
            decoder = found or next(own, None) or _Decoder(file)
            if decoder in self._idle:
                self._idle.remove(decoder)
            self._busy.append(decoder)
            decoder.thread = me
            return decoder

    def _release(self, decoder: _Decoder, *, works: bool) -> None:
        with self._changed:
            self._changed.notify_all()
            self._busy.remove(decoder)
            if works:
                self._idle.append(decoder)
            old = decoder if not works else self._idle.pop(0) if len(self._idle) > _MAX_DECODERS else None
        if old is not None:
            old.close()

    def reset_after_fork(self) -> None:
        """In a forked process: the open files belong to the parent, and its other threads do not exist."""
        self._of_others = self._idle, self._busy, self._kept  # never freed: that is for the process before
        self._reset()

    def _keep(self, key: tuple[_File, int], decoded: _Decoded) -> None:
        with self._changed, suppress(ValueError):  # larger than all of it
            self._changed.notify_all()
            self._kept.setdefault(key, decoded)


def _reached(decoder: _Decoder) -> int:
    """Time stamp of the last frame of a decoder; before all others if unknown."""
    return -(2**63) if decoder.at is None else decoder.at


def _bytes_of(decoded: _Decoded) -> int:
    return sum(plane.buffer_size for plane in decoded.frame.planes)


_decoders = _Decoders()
os.register_at_fork(after_in_child=_decoders.reset_after_fork)
