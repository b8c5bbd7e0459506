"""Frames of video files by their time stamps, in any order; files that are no videos, damaged, or something else."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from av.video.reformatter import Interpolation

from conetl.model.errors import InputError, StorageError
from conetl.perception import video_frames
from conetl.perception.images import ImageFileError
from conetl.perception.video import FrameRef, VideoIndex, frame_of, index_video, video_facts
from conetl.perception.video_frames import frames_between, read_frame
from conetl.perception.video_sync import find_video_lag
from tests.video_drives import write_frames

CODECS = {
    "h264 with B frames.mp4": ("libx264", {"crf": "10", "g": "12", "bf": "3"}),
    "h265 with open groups.mkv": ("libx265", {"crf": "10", "x265-params": "log-level=none:keyint=10:open-gop=1"}),
    "motion jpeg.avi": ("mjpeg", {"q:v": "2"}),
}


def write_video(
    path: Path,
    images: Sequence[np.ndarray],
    codec: str = "libx264",
    options: dict[str, str] | None = None,
    ms: Sequence[int] | None = None,
) -> Path:
    """Images (H, W, 3), even in size, as a video; ms: their time stamps, else 10 Hz."""
    units, counts = (10, range(len(images))) if ms is None else (1000, ms)
    return write_frames(path, images, [n * 10**9 // units for n in counts], codec, options or {"crf": "18"}, units)


def numbered(count: int, size: tuple[int, int] = (96, 64)) -> list[np.ndarray]:
    """Smooth images, each with brightness of its own: 5, 10, 15 ..."""
    return [np.full((size[1], size[0], 3), 5 + 5 * n, np.uint8) for n in range(count)]


@pytest.fixture(params=CODECS)
def video(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    codec, options = CODECS[request.param]
    return write_video(tmp_path / request.param, numbered(50), codec, options)


def test_every_frame_by_its_time_stamp_in_any_order(video: Path) -> None:
    index = index_video(video)
    assert np.allclose(index.times_s() - index.times_s()[0], np.arange(50) / 10)
    assert (index.width_px, index.height_px) == (96, 64)
    assert video_facts(video)[0] == 50
    order = list(range(50))
    random.Random(0).shuffle(order)
    for n in [*order, *range(50)]:
        image = read_frame(FrameRef(video, index.pts[n]), index.sha256(n))
        assert abs(float(image.mean()) - (5 + 5 * n)) < 2.4
        assert abs(float(read_frame(FrameRef(video, index.pts[n]), grey=True).mean()) - (5 + 5 * n)) < 2.4
    for first in range(46):
        assert [pts for pts, _ in frames_between(video, index.pts[first], index.pts[first + 4])] == list(
            index.pts[first : first + 5]
        )


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Time stamps of the frames that are decoded."""
    found: list[int] = []

    def counted(self: video_frames._Decoder) -> Iterator[tuple[int, av.VideoFrame]]:
        for pts, frame in decode(self):
            found.append(pts)
            yield pts, frame

    decode = video_frames._Decoder._decoded
    monkeypatch.setattr(video_frames._Decoder, "_decoded", counted)
    return found


def test_frames_that_are_read_in_order_are_decoded_once(video: Path, decoded: list[int]) -> None:
    """Files list when a key frame is decoded: before frames that are shown before it."""
    index = index_video(video)
    for pts in index.pts:
        read_frame(FrameRef(video, pts))
    assert decoded == list(index.pts)
    for pts in index.pts[40:]:  # of another reader, from the next key frame on
        video_frames._decoders._reset()
        decoded.clear()
        read_frame(FrameRef(video, pts))
        assert len(decoded) <= 24


def test_threads_that_begin_at_different_frames_decode_none_twice(tmp_path: Path, decoded: list[int]) -> None:
    """There is one key frame: who begins later in the file decodes what others read meanwhile."""
    images = [np.full((480, 640, 3), 5 + 4 * n, np.uint8) for n in range(60)]
    made = write_video(tmp_path / "a.mp4", images, "libx264", {"crf": "10", "g": "60"})
    twice = []
    for attempt in range(5):  # on a loaded machine a thread may begin when the others have finished
        index = index_video(shutil.copy(made, tmp_path / f"{attempt}.mp4"))
        parts = [range(30), range(30, 60), range(0, 60, 15)]
        decoded.clear()

        def brightness(part: range, index: VideoIndex = index) -> list[float]:
            frames = [FrameRef(index.path, index.pts[n]) for n in part]
            return [float(read_frame(frame, grey=n % 2 == 0).mean()) for n, frame in zip(part, frames, strict=True)]

        with ThreadPoolExecutor(3) as pool:
            for part, found in zip(parts, pool.map(brightness, parts), strict=True):
                assert np.abs(np.array(found) - (5 + 4 * np.array(part))).max() < 2.4, "of another frame"
        twice.append(len(decoded) - len(set(decoded)))
        assert sorted(set(decoded)) == list(index.pts)
        if not twice[-1]:
            return
    pytest.fail(f"of 60 frames so many were decoded twice, in each attempt: {twice}")


FORKED = """
import subprocess, sys
from concurrent.futures import ThreadPoolExecutor
from conetl.perception.video import frame_of
from conetl.perception.video_frames import read_frame
with ThreadPoolExecutor(1) as pool:
    assert pool.submit(read_frame, frame_of(sys.argv[1])).result().shape == (640, 960, 3)
    assert subprocess.call(["true"], preexec_fn=lambda: None) == 0
"""


def test_a_process_that_is_forked_while_a_thread_has_decoded(tmp_path: Path) -> None:
    """The child forgets all threads but its own, and frees what was theirs alone, before the command begins."""
    video = index_video(write_video(tmp_path / "a.mp4", numbered(4, (960, 640))))
    subprocess.run([sys.executable, "-c", FORKED, str(FrameRef(video.path, video.pts[0]))], check=True, timeout=60)


FORKED_READER = """
import os, sys
from pathlib import Path
from conetl.perception.video import FrameRef, index_video
from conetl.perception.video_frames import read_frame
index = index_video(Path(sys.argv[1]))
grey = lambda n: round(float(read_frame(FrameRef(index.path, index.pts[n]), grey=True).mean()))
assert grey(2) == 15
child = os.fork()
found = [grey(n) for n in range(3, 45)]
assert found == [5 + 5 * n for n in range(3, 45)], found
if not child:
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""


def test_two_processes_read_after_a_fork(tmp_path: Path) -> None:
    """They share the positions in files that were open before it."""
    video = write_video(tmp_path / "a.mkv", numbered(50, (960, 640)), "mjpeg", {"q:v": "2"})
    subprocess.run([sys.executable, "-c", FORKED_READER, str(video)], check=True, timeout=60)


def test_time_stamps_of_a_variable_rate(tmp_path: Path) -> None:
    ms = [0, 33, 70, 200, 233, 1000, 1033]
    index = index_video(write_video(tmp_path / "a.mkv", numbered(7), ms=ms))
    assert np.allclose(index.times_s() * 1000, ms, atol=1)


def test_a_region_is_a_part_of_the_frame(tmp_path: Path) -> None:
    both = np.hstack([np.full((64, 96, 3), 60, np.uint8), np.full((64, 96, 3), 180, np.uint8)])
    path = write_video(tmp_path / "both.mp4", [both] * 3)
    index, region = index_video(path), (96, 0, 96, 64)
    frame = FrameRef(path, index.pts[1], region)
    assert frame_of(str(frame)) == frame
    image = read_frame(frame, index.sha256(1, region))
    assert image.shape == (64, 96, 3) and abs(float(image.mean()) - 180) < 2
    assert index.sha256(1, region) != index.sha256(1)


EXACT = Interpolation.BILINEAR | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT


@pytest.mark.parametrize(
    ("codec", "pixels", "space"),
    [
        ("libx264", "yuv420p", 2), ("libx264", "yuv420p", 1), ("libx264", "yuv420p", 9), ("libx264", "yuvj420p", 5),
        ("libx264", "yuv422p", 2), ("libx264", "yuv420p10le", 2), ("mjpeg", "yuvj420p", 2),
        ("ffv1", "yuv420p", 2), ("ffv1", "gray", 2), ("ffv1", "bgr0", 2),
        ("libx264 chromaloc=1", "yuv420p", 2), ("libx264 chromaloc=2", "yuv420p", 2), ("libx265 chromaloc=1", "yuv420p", 2),
    ],
)  # fmt: skip
def test_pixels_are_those_of_the_librarys_exact_conversion(codec: str, pixels: str, space: int, tmp_path: Path) -> None:
    """In colour and in grey, of a frame and of parts of it. 4:2:0 of H.264 is our own conversion, which rounds elsewhere, unless
    the file states that samples of colour lie between two columns, or in every second row."""
    codec, *stated = codec.split()
    scene = cv2.resize(np.random.default_rng(1).integers(0, 255, (8, 24, 3), np.uint8), (200, 64))
    path = tmp_path / "both.mkv"
    with av.open(str(path), "w") as container:
        options = {f"{codec[3:]}-params": ":".join(["log-level=none", *stated])} if stated else {}
        stream = container.add_stream(codec, rate=10, options=options)
        stream.width, stream.height, stream.pix_fmt = 200, 64, pixels
        stream.codec_context.colorspace = space
        frame = av.VideoFrame.from_ndarray(scene, format="bgr24").reformat(format=pixels, dst_colorspace=space)
        container.mux([*stream.encode(frame), *stream.encode(None)])
    with av.open(str(path)) as container:
        (stored,) = container.decode(video=0)
    colours = stored.to_ndarray(format="bgr24", interpolation=EXACT)
    grey = stored.to_ndarray(format="gray", interpolation=EXACT)
    is_own = codec == "libx264" and pixels in ("yuv420p", "yuvj420p") and not stated
    for region in (None, (0, 0, 100, 64), (100, 0, 100, 64), (0, 31, 200, 33), (33, 0, 67, 64)):
        x, y, width, height = region or (0, 0, 200, 64)
        part, frame_name = np.s_[y : y + height, x : x + width], FrameRef(path, 0, region)
        off = read_frame(frame_name).astype(int) - colours[part]
        # At its edges a part has no colours of what is beside it.
        off = off[2 * (y > 0) :, : width - 2 * (x + width < 200)]
        assert np.abs(off).max() <= (3 if is_own else 0) and np.abs(off.mean(axis=(0, 1))).max() < 0.5
        if space in (2, 5):  # of others the library makes another brightness than the file's
            np.testing.assert_array_equal(read_frame(frame_name, grey=True), grey[part])
    with pytest.raises(ImageFileError, match="changes size"):
        read_frame(FrameRef(path, 0, (150, 0, 100, 64)))


@pytest.mark.parametrize(
    "name", ["left/0001.png", "left.mp4", "left.mp4#t=3", "left.png#pts=4", "a.mp4#pts=1&xywh=1,2,3"]
)
def test_other_names_are_no_frames(name: str) -> None:
    assert frame_of(name) is None


def test_a_video_that_changed_is_noticed(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", numbered(5))
    other = index_video(write_video(tmp_path / "b.mp4", numbered(9)[4:]))
    with pytest.raises(StorageError, match="changed while conetl read it"):
        read_frame(FrameRef(path, other.pts[0]), other.sha256(0))


@pytest.mark.parametrize("codec", ["libx264", "mjpeg"])
def test_a_video_that_is_removed_or_cut_while_it_is_read_has_no_damaged_frames(codec: str, tmp_path: Path) -> None:
    """They would be stored as the drive's, and remain lost when the file is there again."""
    path = write_video(tmp_path / "a.mkv", shaken(40, 1), codec, {"q:v": "2"} if codec == "mjpeg" else None)
    index = index_video(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    read_frame(FrameRef(path, index.pts[0]), index.sha256(0))
    with pytest.raises(StorageError, match=r"changed while conetl read it.*again when nothing writes"):
        read_frame(FrameRef(path, index.pts[39]), index.sha256(39))
    path.unlink()
    with pytest.raises(StorageError, match=r"changed while conetl read it.*No such file"):
        read_frame(FrameRef(path, index.pts[0]), index.sha256(0))
    path.write_bytes(data)
    assert read_frame(FrameRef(path, index.pts[39]), index.sha256(39)).any()


def test_frames_after_damage_in_an_avi_file_keep_their_times(tmp_path: Path) -> None:
    """Its packets have no time stamps, and the library counts only those that it finds."""
    path = write_video(tmp_path / "a.avi", shaken(40, 1), "mjpeg", {"q:v": "2"})
    good, data = index_video(path), bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        places = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    data[places[15][0] - 8 : sum(places[17])] = bytes(sum(places[17]) - places[15][0] + 8)
    bad = path.with_name("b.avi")
    bad.write_bytes(data)
    index = index_video(bad)
    known = {pts: index.sha256(n) for n, pts in enumerate(index.pts)}
    kept = [n for n, pts in enumerate(good.pts) if known.get(pts) == good.sha256(n)]
    assert kept == [n for n in range(40) if n not in (15, 16, 17)]
    for n in [39, 2, 20, *kept]:
        seen = read_frame(FrameRef(bad, good.pts[n]), good.sha256(n))
        assert np.array_equal(seen, read_frame(FrameRef(path, good.pts[n])))


def test_a_damaged_first_key_frame_is_searched_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every search decodes the rest of the file."""
    path = write_video(tmp_path / "a.mp4", shaken(60, 1), "libx264", {"crf": "20", "g": "100", "bf": "0"})
    index, data = index_video(path), bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        at, size = next((packet.pos, packet.size) for packet in container.demux(video=0) if packet.size)
    data[at : at + size] = b"\xff" * size
    path.write_bytes(data)
    index, seek, sought = index_video(path), video_frames._Decoder.seek, []
    monkeypatch.setattr(video_frames._Decoder, "seek", lambda self, pts: (sought.append(pts), seek(self, pts)))
    for n in range(60):
        with pytest.raises(ImageFileError, match="damaged or missing"):
            read_frame(FrameRef(path, index.pts[n]), index.sha256(n))
    assert sought == [index.pts[0]]


def test_damage_costs_the_damaged_frames_only(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (40, 64, 96, 3), dtype=np.uint8)
    path = write_video(tmp_path / "a.avi", list(noise), "mjpeg", {"q:v": "2"})
    good = index_video(path)
    data = bytearray(path.read_bytes())
    at = data.index(b"\xff\xda", len(data) // 2)
    data[at : at + 900] = bytes(900)
    path.with_name("b.avi").write_bytes(data)
    index = index_video(path.with_name("b.avi"))
    changed = [n for n in range(40) if index.sha256(n) != good.sha256(n)]
    assert 1 <= len(changed) <= 2
    for n in set(range(40)) - set(changed):
        assert np.array_equal(read_frame(FrameRef(index.path, index.pts[n])), read_frame(FrameRef(path, good.pts[n])))


def test_what_is_no_video(tmp_path: Path) -> None:
    playlist = tmp_path / "list.mp4"
    playlist.write_text("#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n")
    text, whole = tmp_path / "text.mp4", write_video(tmp_path / "a.mp4", numbered(9))
    text.write_text("left right")
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole.read_bytes()[:-400])
    for path in (playlist, text, cut, tmp_path / "none.mp4"):
        with pytest.raises(InputError, match=path.name):
            index_video(path)
        with pytest.raises(ImageFileError, match=path.name):
            read_frame(FrameRef(path, 0))
    with pytest.raises(ImageFileError, match="damaged or missing"):
        read_frame(FrameRef(whole, 7))


def shaken(count: int, seed: int) -> list[np.ndarray]:
    """A textured scene under a camera that shakes."""
    rng = np.random.default_rng(seed)
    scene = cv2.GaussianBlur(rng.integers(0, 255, (240, 400, 3), dtype=np.uint8), (0, 0), 3)
    scene = cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    x, y = rng.integers(0, 12, (2, count))
    return [scene[20 + v : 180 + v, 20 + u : 340 + u] for u, v in zip(x, y, strict=True)]


def test_the_shift_of_two_files_and_frames_that_one_lost(tmp_path: Path) -> None:
    images = shaken(240, 1)
    left = index_video(write_video(tmp_path / "left.mp4", images[:200]))
    for first in (0, 31):
        right = index_video(
            write_video(tmp_path / f"right{first}.mp4", [255 - image for image in images[first : first + 190]])
        )
        lag = find_video_lag(left, right)
        assert lag is not None and lag.is_constant
        assert lag.offset_s == pytest.approx(first / 10, abs=0.02)
    lost = find_video_lag(left, index_video(write_video(tmp_path / "lost.mp4", images[:100] + images[106:200])))
    assert lost is not None and not lost.is_constant
    still = index_video(write_video(tmp_path / "still.mp4", images[:1] * 200))
    assert find_video_lag(left, still) is None


def test_frames_that_build_on_a_damaged_one_are_refused(tmp_path: Path) -> None:
    """Decoders fill a lost slice from the frame before: pixels of an earlier image."""
    path = write_video(tmp_path / "a.mp4", shaken(30, 1), "libx264", {"crf": "20", "g": "10", "bf": "0"})
    good, data = index_video(path), bytearray(path.read_bytes())
    with av.open(str(path)) as container:
        at, size = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size][13]
    data[at + 6 : at + size - 2] = b"\xff" * (size - 8)
    bad = path.with_name("b.mp4")
    bad.write_bytes(data)
    for n, pts in enumerate(good.pts):
        if 13 <= n < 20:
            with pytest.raises(ImageFileError, match="damaged or missing"):
                read_frame(FrameRef(bad, pts))
        else:
            assert np.array_equal(read_frame(FrameRef(bad, pts)), read_frame(FrameRef(path, pts)))


def test_short_recordings_and_time_stamps_without_distance(tmp_path: Path) -> None:
    short = index_video(write_video(tmp_path / "a.mp4", shaken(32, 1)))
    lag = find_video_lag(short, short)
    assert lag is None or abs(lag.offset_s) < 0.01
    assert find_video_lag(short._replace(time_base=short.time_base / 10**9), short) is None


def test_one_stream_of_images_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "two.mkv"
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("libx264", rate=10) for _ in range(2)]
        for stream in streams:
            stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for stream in streams:
            image = av.VideoFrame.from_ndarray(np.zeros((64, 96, 3), np.uint8), format="bgr24")
            for packet in (*stream.encode(image), *stream.encode(None)):
                container.mux(packet)
    with pytest.raises(InputError, match="2 video streams, expected one"):
        index_video(path)
