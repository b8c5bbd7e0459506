"""Drive folders that are being written: what counts as there, line by line and file by file."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from conetl.model.errors import InputError
from conetl.model.rejections import RejectionReason
from conetl.readers.drives import read_drive
from conetl.readers.drives.pairs import PairError
from conetl.readers.recording import ArrivingPair, ArrivingPlain, GrowingFile, open_arriving
from tests.arriving_drives import SAMPLE, append, begin, image, kitti_head, row, write_images

SRID = 32632


def test_the_format_is_not_known_yet(tmp_path: Path) -> None:
    assert open_arriving(tmp_path) is None
    (tmp_path / "drive.yaml").write_text("drive_id: morning\n")
    assert open_arriving(tmp_path) is None  # plain or KITTI: images or a trajectory decide


def test_a_format_that_cannot_be_watched_is_named(tmp_path: Path) -> None:
    for name in ("cam0", "cam1"):
        (tmp_path / "mav0" / name / "data").mkdir(parents=True)
    with pytest.raises(InputError, match="ingest it when it is complete"):
        open_arriving(tmp_path)


def test_rows_count_once_they_end(tmp_path: Path) -> None:
    folder = begin(tmp_path / "d")
    drive = open_arriving(folder)
    assert isinstance(drive, ArrivingPlain)
    line = row(10)
    for end in (5, len(line) - 1):
        append(folder, line[:end] if end == 5 else line[5:end])
        drive.new_pairs([])
        assert drive.rows.by_stem == {}
    append(folder, line[-1] + row(11, lat_deg="north") + row(10))
    drive.new_pairs([])
    assert drive.rows.numbers == {"000010": 0, "000011": 1}
    assert "in two rows" in str(drive.rows.by_stem["000010"])
    assert "lat_deg" in str(drive.rows.by_stem["000011"])
    (folder / "trajectory.csv").write_text("stem,when\n")
    with pytest.raises(InputError, match="wrong columns"):
        open_arriving(folder).new_pairs(None)


def test_a_plain_pair_needs_both_images_and_its_row(tmp_path: Path) -> None:
    folder = begin(tmp_path / "d")
    drive = open_arriving(folder)
    assert drive is not None and drive.drive_id == "d" and drive.rig() is not None
    data, name = image(10, "left")
    (folder / "left" / name).write_bytes(data)
    assert drive.new_pairs(None) == []
    (folder / "right" / name).write_bytes(data)
    (pair,) = drive.new_pairs([folder / "right" / name])
    assert drive.new_pairs(None) == []  # returned once
    assert drive.frame_pair(pair, SRID) is None
    append(folder, row(10))
    drive.new_pairs([])
    found = drive.frame_pair(pair, None)
    assert found is not None and found[1] == SRID and found[0].frame_index == 0
    write_images(folder, 12)
    write_images(folder, 11)
    append(folder, row(11))
    pairs = drive.new_pairs(None)
    assert [p.key for p in sorted(pairs, key=drive.order)] == ["000011", "000012"]  # the one without a row comes last


def test_a_known_name_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An hour's drive has 72,000 names, listed again and again."""
    folder = begin(tmp_path / "d")
    for number in (10, 11):
        write_images(folder, number)
    (folder / "left" / ".000012.jpg.part").touch()
    drive = open_arriving(folder)
    assert drive is not None and len(drive.new_pairs(None)) == 2
    asked: list[str] = []

    def splitext(name: str) -> tuple[str, str]:
        asked.append(name)
        return real(name)

    real = os.path.splitext
    monkeypatch.setattr(os.path, "splitext", splitext)
    assert drive.new_pairs(None) == [] and asked == []
    write_images(folder, 12)
    assert [pair.left_path for pair in drive.new_pairs(None)] == [folder.resolve() / "left" / "000012.jpg"]
    assert asked == ["000012.jpg"] * 2


def test_stamps_are_read_once(tmp_path: Path) -> None:
    path = tmp_path / "timestamps.txt"
    stamps = GrowingFile(path)
    assert stamps.line(0) is None and not path.exists()
    path.write_bytes(b"first\r\nsec")
    assert (stamps.line(0), stamps.line(1)) == ("first\r", None)
    with path.open("ab") as file:
        file.write(b"ond\nthird\n")
    assert [stamps.line(n) for n in (2, 1, 3)] == ["third", "second", None]
    # a recorder that rewrites the whole file each time: under another name and renamed, or in place and shorter
    (tmp_path / "new").write_bytes(b"1st\n2nd\n3rd\n4th\n")
    (tmp_path / "new").replace(path)
    assert [stamps.line(n) for n in (3, 0)] == ["4th", "1st"]
    path.write_bytes(b"I\nII\n")
    assert [stamps.line(n) for n in (4, 0, 3)] == [None, "I", None]
    path.unlink()
    assert [stamps.line(n) for n in (1, 2)] == ["II", None]


def arriving_kitti(folder: Path, numbers: range) -> tuple[object, list[ArrivingPair]]:
    kitti_head(folder)
    for number in numbers:
        for name in ("image_02", "image_03"):
            shutil.copy(SAMPLE / name / "data" / f"{number:010d}.jpg", folder / name / "data")
    drive = open_arriving(folder)
    assert drive is not None
    return drive, sorted(drive.new_pairs(None), key=drive.order)


def test_a_kitti_pair_needs_its_record_and_both_time_stamps(tmp_path: Path) -> None:
    drive, pairs = arriving_kitti(tmp_path / "k", range(3))
    assert drive.rig() is not None
    record = (SAMPLE / "oxts" / "data" / "0000000000.txt").read_text()
    (tmp_path / "k" / "oxts" / "data" / "0000000000.txt").write_text(record[:60])
    stamps = {name: (SAMPLE / name / "timestamps.txt").read_text() for name in ("image_02", "oxts")}
    first = stamps["image_02"].splitlines(keepends=True)[0]
    (tmp_path / "k" / "image_02" / "timestamps.txt").write_text(first[:12])
    assert drive.frame_pair(pairs[0], SRID) is None
    (tmp_path / "k" / "oxts" / "data" / "0000000000.txt").write_text(record)
    assert drive.frame_pair(pairs[0], SRID) is None
    (tmp_path / "k" / "image_02" / "timestamps.txt").write_text(stamps["image_02"])
    assert drive.frame_pair(pairs[0], SRID) is None  # the record's own time may still come
    (tmp_path / "k" / "oxts" / "timestamps.txt").write_text(stamps["oxts"])
    assert drive.frame_pair(pairs[0], SRID) is not None
    (tmp_path / "k" / "oxts" / "data" / "0000000001.txt").write_text("nan " * 30)
    with pytest.raises(PairError) as error:
        drive.frame_pair(pairs[1], SRID)
    assert error.value.reason is RejectionReason.POSE_INVALID


def test_poses_are_those_of_the_whole_drive(tmp_path: Path) -> None:
    """Live, the record after the exposure is not there: the motion since the one before is carried on."""
    drive, pairs = arriving_kitti(tmp_path / "k", range(6))
    for name in ("image_02", "oxts"):
        shutil.copy(SAMPLE / name / "timestamps.txt", tmp_path / "k" / name)
    whole, _ = read_drive(SAMPLE, map_srid=SRID, headers_only=True)
    for number, pair in enumerate(pairs):
        shutil.copy(SAMPLE / "oxts" / "data" / f"{number:010d}.txt", tmp_path / "k" / "oxts" / "data")
        found = drive.frame_pair(pair, SRID)
        assert found is not None
        wanted = whole.frame_pairs[number]
        assert found[0].captured_at_ns == wanted.captured_at_ns
        np.testing.assert_allclose(found[0].pose.map_t_body_m, wanted.pose.map_t_body_m, atol=0.02)
        np.testing.assert_allclose(found[0].pose.map_R_body, wanted.pose.map_R_body, atol=1e-3)
