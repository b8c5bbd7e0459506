"""Frames of videos of a board: still and distinct ones, of the same instants in both files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from conetl.cli.tools.calibrate import calibrate
from conetl.model.errors import ConetlError, InputError
from conetl.perception.boards.boards import parse_board
from conetl.perception.boards.images import ImagePair, find_boards
from conetl.perception.boards.videos import Layout, find_videos, open_videos, pairs_in_videos, region_of
from conetl.perception.video import frame_of, index_video
from conetl.perception.video_frames import read_frame
from tests.unit.perception.test_boards import QUAD, _seen
from tests.unit.perception.test_video import write_video

SIZE = (96, 64)
#: Frames (10 Hz) for which each of the views stands still; the camera moves for three frames between.
STILL = (11, 19, 14, 26, 12, 17, 23, 13)


def views(seed: int) -> list[np.ndarray]:
    """One blurred random image per view, 0 to 255."""
    rng = np.random.default_rng(seed)
    return [
        cv2.resize(rng.integers(0, 255, (8, 12, 3), dtype=np.uint8), SIZE, interpolation=cv2.INTER_CUBIC) for _ in STILL
    ]


def film(images: list[np.ndarray]) -> list[np.ndarray]:
    frames: list[np.ndarray] = []
    for image, after, count in zip(images, [*images[1:], images[0]], STILL, strict=True):
        frames += [image] * count + [cv2.addWeighted(image, 1 - a, after, a, 0) for a in (0.25, 0.5, 0.75)]
    return frames


def view_of(path: Path | None, images: list[np.ndarray]) -> int:
    """Number of the view that a frame shows."""
    frame = frame_of(str(path))
    assert frame is not None
    misses = [float(np.abs(read_frame(frame).astype(float) - image).mean()) for image in images]
    assert min(misses) < 6, "a frame between two views"
    return int(np.argmin(misses))


@pytest.mark.parametrize(("late", "given"), [(0, None), (14, None), (7, 0.7)])
def test_one_pair_of_every_view(tmp_path: Path, late: int, given: float | None) -> None:
    left, right = views(1), views(2)
    files = [write_video(tmp_path / "left.mp4", film(left)), write_video(tmp_path / "right.mp4", film(right)[late:])]
    found = pairs_in_videos(open_videos(find_videos(tmp_path, None), None), given)
    assert found.offset_s == pytest.approx(late / 10, abs=0.1)
    shown = [(view_of(pair.left, left), view_of(pair.right, right)) for pair in found.pairs]
    assert [a for a, _ in shown] == [b for _, b in shown], "two views in one pair"
    assert {a for a, _ in shown} >= set(range(2, len(left))) and len(shown) <= len(left)
    assert files[0].name in str(found.pairs[0].left)


@pytest.mark.parametrize("layout", ["left-right", "right-left", "top-bottom", "bottom-top"])
def test_one_file_with_both_images(tmp_path: Path, layout: Layout) -> None:
    left, right = views(1), views(2)
    first, second = (left, right) if layout.startswith(("left", "top")) else (right, left)
    stack = np.hstack if "left" in layout else np.vstack
    write_video(tmp_path / "both.mp4", film([stack(both) for both in zip(first, second, strict=True)]))
    found = pairs_in_videos(open_videos(find_videos(tmp_path, layout), layout))
    shown = [(view_of(pair.left, left), view_of(pair.right, right)) for pair in found.pairs]
    assert shown == [(n, n) for n in range(len(left))]
    assert region_of(index_video(tmp_path / "both.mp4"), None, "left") is None


def test_videos_that_cannot_be_used(tmp_path: Path) -> None:
    left, right = views(1), views(2)
    write_video(tmp_path / "left.mp4", film(left))
    write_video(tmp_path / "still right.mp4", [right[0]] * 150)
    write_video(tmp_path / "short.mp4", right)
    both = [tmp_path / "left.mp4", tmp_path / "still right.mp4"]
    with pytest.raises(InputError, match=r"still right.mp4: its time offset from left.mp4.*--offset-s"):
        pairs_in_videos(open_videos(both, None))
    with pytest.raises(InputError, match=r"short.mp4: 0.7 s long, expected 1 s to 30 minutes"):
        open_videos([tmp_path / "left.mp4", tmp_path / "short.mp4"], None)
    with pytest.raises(InputError, match="give two video files, or one with --layout"):
        open_videos(both[:1], None)
    with pytest.raises(InputError, match="one video each with left and right in its name"):
        find_videos(tmp_path, "left-right")
    rng = np.random.default_rng(0)
    write_video(tmp_path / "moving.mp4", [rng.integers(0, 255, (64, 96, 3), dtype=np.uint8) for _ in range(40)])
    with pytest.raises(InputError, match="never stands still"):
        pairs_in_videos(open_videos([tmp_path / "left.mp4", tmp_path / "moving.mp4"], None), 0.0)


def test_corners_of_a_frame_are_those_of_the_image(tmp_path: Path) -> None:
    board = parse_board("chessboard:9x6:40mm")
    image, true = _seen(board, QUAD)
    video = write_video(tmp_path / "left.mp4", [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)] * 3, options={"crf": "10"})
    frame = Path(f"{video}#pts={index_video(video).pts[1]}")
    found = find_boards([ImagePair("a", frame, None)], board)
    uv = found.views[0].uv_px
    uv = uv if np.linalg.norm(uv[0] - true[0]) < 20 else uv[::-1]
    assert np.hypot(*(uv - true[found.views[0].point_ids]).T).max() < 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("{0}/none.mp4", "{0}/b.mp4"), "none.mp4: no such folder or file"),
        (("{0}", "{0}"), "one folder, two video files"),
        (("{0}/a.mp4",), "a.mp4: give two video files, or one with --layout"),
        (("{0}/a.mp4", "{0}/b.mp4"), "the video cannot be opened"),
        (("{0}/images", "--layout", "left-right"), "--layout requires a video file"),
    ],
)
def test_sources_that_are_no_videos(tmp_path: Path, words: tuple[str, ...], message: str) -> None:
    (tmp_path / "a.mp4").write_bytes(b"no video")
    (tmp_path / "b.mp4").write_bytes(b"no video")
    (tmp_path / "images").mkdir()
    app = typer.Typer()
    app.command()(calibrate)
    result = CliRunner().invoke(app, [*(word.format(tmp_path) for word in words), "--board", "chessboard:9x6:40mm"])
    assert isinstance(result.exception, ConetlError) and message in str(result.exception)
