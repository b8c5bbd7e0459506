"""ROS 1 bags beyond what all formats share: compression, folders, foreign types, damaged and hostile indexes."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer
from rosbags.rosbag1.reader import Reader

from conetl.model.drive import Drive
from conetl.model.errors import DriveFolderError
from conetl.pipeline.entries import Entry, find_entries
from conetl.readers.drives import bags, find_format, read_drive
from conetl.readers.drives.header import read_header
from tests.unit.readers.drive_formats import SIGMAS, georeference, sample_frames, sample_rig, write_ros1_bag

FRAMES, RIG = sample_frames()[:4], sample_rig()


def read(path: Path) -> Drive:
    drive, rejections = read_drive(path, images_folder=path.parent / "cache")
    assert rejections == []
    return drive


@pytest.mark.parametrize("compression", [*Writer.CompressionFormat])
def test_compression_changes_nothing(compression: Writer.CompressionFormat, tmp_path: Path) -> None:
    plain = read(write_ros1_bag(tmp_path / "plain" / "run", FRAMES, RIG))
    packed = write_ros1_bag(tmp_path / "packed" / "run", FRAMES, RIG, compression=compression, chunk_bytes=50_000)
    assert read(packed).content_sha256 == plain.content_sha256


def test_a_folder_with_one_bag_is_a_drive(tmp_path: Path) -> None:
    file = write_ros1_bag(tmp_path / "day" / "run" / "2026-03-02-10-00-00", FRAMES, RIG, odometry=True)
    folder = file.parent
    (folder / "drive.yaml").write_text(georeference(FRAMES) + SIGMAS)
    assert (find_format(folder), find_entries(tmp_path)) == (bags, [Entry(folder)])
    assert (read_header(folder).problem, read_header(folder).frame_pairs) == (None, len(FRAMES))
    drive = read(folder)
    assert (drive.drive_id, len(drive.frame_pairs)) == ("run", len(FRAMES))
    (folder / "drive.yaml").unlink()
    shutil.copy(file, folder / "2026-03-02-10-05-00.bag")
    with pytest.raises(DriveFolderError, match=r"contains 2 drives \(2026-03-02-10-00-00.bag"):
        read(folder)


def test_types_that_are_not_used_may_have_any_definition(tmp_path: Path) -> None:
    file = write_ros1_bag(tmp_path / "run", FRAMES, RIG)
    writer_add = Writer.add_connection

    def add(self: Writer, topic: str, msgtype: str, **options: Any) -> Any:
        if not self.connections:
            writer_add(self, "/radar", "radar_msgs/msg/Scan", msgdef="this is @ no definition", md5sum="*")
        return writer_add(self, topic, msgtype, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Writer, "add_connection", add)
        other = write_ros1_bag(tmp_path / "other" / "run", FRAMES, RIG)
    assert read(other).content_sha256 == read(file).content_sha256


@pytest.mark.parametrize("cut", [20, 2_000, 150_000])
def test_a_bag_that_was_cut_off_is_refused(cut: int, tmp_path: Path) -> None:
    file = write_ros1_bag(tmp_path / "run", FRAMES, RIG)
    file.write_bytes(file.read_bytes()[:-cut])
    with pytest.raises(DriveFolderError, match=r"run\.bag: the bag cannot be read: .*'rosbag reindex run\.bag'"):
        read(file)
    problem = read_header(file).problem
    assert problem is not None and "rosbag reindex" in problem


def test_a_bag_without_an_index_is_refused(tmp_path: Path) -> None:
    """As a recorder that died leaves it: index_pos is written last."""
    file = write_ros1_bag(tmp_path / "run", FRAMES, RIG)
    data = file.read_bytes()
    at = data.index(b"index_pos=") + 10
    file.write_bytes(data[:at] + bytes(8) + data[at + 8 :])
    with pytest.raises(DriveFolderError, match=r"not indexed.*'rosbag reindex run.bag'"):
        read(file)


@pytest.mark.parametrize("compression", [None, *Writer.CompressionFormat])
def test_a_chunk_beyond_the_limit_is_refused(
    compression: Writer.CompressionFormat | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("conetl.readers.drives.bags.messages.MAX_CHUNK_BYTES", 200_000)
    file = write_ros1_bag(tmp_path / "run", FRAMES, RIG, compression=compression, chunk_bytes=1 << 20)
    with pytest.raises(DriveFolderError, match=r"chunk is .*larger than 0 MB: record smaller chunks"):
        read(file)


def test_an_index_that_names_a_message_twice_is_refused(tmp_path: Path) -> None:
    file = write_ros1_bag(tmp_path / "run", FRAMES, RIG, chunk_bytes=1 << 22)
    with Reader(file) as reader:
        fixes = next(reader.indexes[c.id] for c in reader.connections if c.topic == "/gnss/fix")
        first, second = fixes[0].offset, fixes[1].offset
    data = file.read_bytes()
    stamp = struct.pack("<LL", *divmod(fixes[1].time, 10**9))
    assert data.count(stamp + struct.pack("<L", second)) == 1
    file.write_bytes(data.replace(stamp + struct.pack("<L", second), stamp + struct.pack("<L", first)))
    with pytest.raises(DriveFolderError, match="index contains a message twice"):
        read(file)


def test_an_index_that_names_a_chunk_often_is_refused(tmp_path: Path) -> None:
    """Each chunk info at the end of the file may point to the largest chunk."""
    file = write_ros1_bag(tmp_path / "run", FRAMES, RIG, chunk_bytes=60_000)
    with Reader(file) as reader:
        positions = [info.pos for info in reader.chunk_infos]
    data = file.read_bytes()
    for position in positions[1:]:
        data = data.replace(
            b"chunk_pos=" + struct.pack("<Q", position), b"chunk_pos=" + struct.pack("<Q", positions[0])
        )
    file.write_bytes(data)
    with pytest.raises(DriveFolderError, match="the bag cannot be read"):
        read(file)
