"""`conetl detect` on images of users, and with paths that cannot be written."""

from __future__ import annotations

import json
from pathlib import Path
from subprocess import CompletedProcess

import cv2
import numpy as np
import pytest

from tests.command import ROOT, conetl

IMAGE = next((ROOT / "data" / "drives").glob("*/image_02/data/*"))


def run(*arguments: object, folder: Path) -> CompletedProcess[str]:
    return conetl("detect", *arguments, cwd=folder)


@pytest.fixture
def small_image(tmp_path: Path) -> Path:
    path = tmp_path / "in" / "small.png"
    path.parent.mkdir()
    cv2.imwrite(str(path), np.full((64, 96, 3), 120, np.uint8))
    return path


def test_boxes_and_annotated_copies_are_written_into_new_folders(tmp_path: Path) -> None:
    done = run(IMAGE, "--out", tmp_path / "new" / "found.json", "--draw", tmp_path / "drawn" / "deep", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "new" / "found.json").read_text())
    assert found
    assert {"file_name", "category", "bbox", "score", "foot", "tip"} <= set(found[0])
    assert cv2.imread(str(tmp_path / "drawn" / "deep" / f"{IMAGE.stem}.jpg")).shape == cv2.imread(str(IMAGE)).shape


@pytest.mark.parametrize("option", ["--out", "--draw"])
def test_a_path_that_cannot_be_written_is_bad_input(tmp_path: Path, small_image: Path, option: str) -> None:
    (tmp_path / "file").write_text("taken")
    done = run(small_image, option, tmp_path / "file" / "below", folder=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "cannot be written" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "detections.json").exists()


def test_one_unreadable_image_costs_only_itself(tmp_path: Path, small_image: Path) -> None:
    (small_image.parent / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 no image")
    done = run(small_image.parent, "--json", folder=tmp_path)
    assert done.returncode == 1 and "broken.jpg" in done.stderr
    result = json.loads(done.stdout)
    assert result["images"] == 2
    assert [Path(name).name for name in result["refused"]] == ["broken.jpg"]


def test_nothing_is_written_where_no_image_can_be_read(tmp_path: Path) -> None:
    (tmp_path / "broken.png").write_bytes(b"\x89PNG no image")
    done = run(tmp_path / "broken.png", "--out", tmp_path / "found.json", folder=tmp_path)
    assert done.returncode == 2
    assert not (tmp_path / "found.json").exists()
