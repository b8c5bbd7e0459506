"""Drives in S3-compatible storage: a real server of moto on loopback, spoken to by s3fs."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cachetools import LRUCache

from conetl.files import storage as places
from conetl.files.parquet_store import file_sha256
from conetl.files.storage import as_path, fetch, is_remote, object_bytes
from conetl.model.errors import DriveFolderError, ServiceError
from conetl.model.rejections import RejectionReason
from conetl.perception.images import ImageFileError, read_bytes
from conetl.perception.rectified_image import read_rig_image
from conetl.readers.drives import find_format, read_drive
from conetl.readers.drives.header import read_header
from tests.object_storage import BUCKET, object_storage
from tests.unit.readers.drive_formats import SAMPLE, Frame, sample_frames, write_kitti, write_plain

RIG = read_drive(SAMPLE, headers_only=True)[0].rig
WRITERS: dict[str, Callable[..., Path]] = {"kitti": write_kitti, "plain": write_plain}


@pytest.fixture(scope="module")
def storage() -> Iterator[pytest.MonkeyPatch]:
    """A storage server with an empty bucket, and the usual environment that leads to it."""
    with object_storage() as environment:
        yield environment


def upload(folder: Path, name: str) -> Path:
    """A drive folder as objects."""
    target = as_path(f"s3://{BUCKET}/{name}")
    target.fs.put(f"{folder}/", f"{BUCKET}/{name}/", recursive=True)  # type: ignore[attr-defined]
    return target


@pytest.fixture(params=sorted(WRITERS))
def drive(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Path]:
    frames: list[Frame] = sample_frames()[:4]
    return request.param, WRITERS[request.param](tmp_path / f"drive_{request.param}", frames, RIG)


def test_a_drive_reads_as_it_does_from_disk(drive: tuple[str, Path], storage: pytest.MonkeyPatch) -> None:
    name, folder = drive
    remote = upload(folder, folder.name)
    assert is_remote(remote)
    assert find_format(remote).NAME == find_format(folder).NAME == name
    ours, refused = read_drive(folder)
    theirs, refused_there = read_drive(Path(f"s3:/{BUCKET}/{folder.name}"))  # as `pathlib` writes an address
    assert theirs.content_sha256 == ours.content_sha256
    assert (theirs.rig, theirs.drive_id, theirs.map_srid) == (ours.rig, ours.drive_id, ours.map_srid)
    assert refused == refused_there
    for mine, its in zip(ours.frame_pairs, theirs.frame_pairs, strict=True):
        assert (mine.frame_index, mine.captured_at_ns, mine.pose) == (its.frame_index, its.captured_at_ns, its.pose)
        assert its.left_path.startswith(f"s3://{BUCKET}/")
        image = as_path(its.left_path)
        assert file_sha256(image) == file_sha256(Path(mine.left_path))
        assert (
            read_rig_image(image, theirs.rig, "left") == read_rig_image(Path(mine.left_path), ours.rig, "left")
        ).all()
    local, there = read_header(folder), read_header(remote)
    assert there.problem is None
    assert (there.header_sha256, there.frame_pairs, there.captured_from) == (
        local.header_sha256, local.frame_pairs, local.captured_from,
    )  # fmt: skip


def test_a_missing_image_costs_its_pair_and_is_named(tmp_path: Path, storage: pytest.MonkeyPatch) -> None:
    folder = write_kitti(tmp_path / "gap", sample_frames()[:4], RIG)
    remote = upload(folder, "gap")
    read, _ = read_drive(remote)
    gone = as_path(read.frame_pairs[2].right_path)
    gone.unlink()
    again, refused = read_drive(remote)
    assert len(again.frame_pairs) == 3
    assert [rejection.reason for rejection in refused] == [RejectionReason.IMAGE_MISSING]


def test_a_missing_object_is_named(storage: pytest.MonkeyPatch) -> None:
    with pytest.raises(DriveFolderError, match=f"s3://{BUCKET}/nowhere"):
        read_drive(as_path(f"s3://{BUCKET}/nowhere"))


def test_unavailable_storage_is_a_missing_service(storage: pytest.MonkeyPatch) -> None:
    import s3fs

    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
        environment.setenv("AWS_MAX_ATTEMPTS", "1")  # else it tries five times, with seconds in between
        s3fs.S3FileSystem.clear_instance_cache()
        try:
            with pytest.raises(ServiceError, match="s3://elsewhere/drive"):
                read_drive(as_path("s3://elsewhere/drive"))
        finally:
            s3fs.S3FileSystem.clear_instance_cache()


@pytest.mark.parametrize(
    "said",
    [
        OSError(errno.EBUSY, "Please reduce your request rate."),
        OSError(errno.EIO, "We encountered an internal error."),
        PermissionError("The provided token has expired."),
        PermissionError("Access Denied"),
        TimeoutError("no answer"),
    ],
    ids=["SlowDown", "InternalError", "ExpiredToken", "AccessDenied", "time-out"],
)
def test_what_storage_says_of_itself_is_no_property_of_an_object(
    monkeypatch: pytest.MonkeyPatch, said: OSError
) -> None:
    """s3fs translates errors of the storage to Python's own."""
    path = as_path("memory://storage/image.jpg")
    path.write_bytes(b"an image")
    places.forget_all()

    def fail(*_: object, **__: object) -> bytes:
        raise said

    with monkeypatch.context() as failing:
        failing.setattr(path.fs, "cat_file", fail)  # type: ignore[attr-defined]
        failing.setattr(path.fs, "open", fail)  # type: ignore[attr-defined]
        for read in (object_bytes, file_sha256, read_bytes):
            with pytest.raises(ServiceError, match=f"image.jpg: cannot be read from the storage: .*{said.args[-1]}"):
                read(path)
    assert read_bytes(path) == b"an image"


def test_an_object_that_is_not_there_is_one(storage: pytest.MonkeyPatch) -> None:
    path = as_path(f"s3://{BUCKET}/nowhere/image.jpg")
    assert file_sha256(path) == places.NO_FILE_SHA256
    with pytest.raises(FileNotFoundError):
        object_bytes(path)
    with pytest.raises(ImageFileError) as raised:
        read_bytes(path)
    assert raised.value.reason is RejectionReason.IMAGE_MISSING


def test_what_stays_in_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(places, "_kept", LRUCache(2_500, getsizeof=len))
    paths = [as_path(f"memory://bounded/{k}") for k in range(10)]
    for k, path in enumerate(paths):
        path.write_bytes(bytes([k]) * 1_000)
    for k, path in enumerate(paths):
        fetch([path])
        assert object_bytes(path) == bytes([k]) * 1_000
    assert [places._kept.get(str(path)) is not None for path in paths] == [False] * 8 + [True] * 2


def test_an_object_that_was_rewritten_is_hashed_again() -> None:
    path = as_path("memory://changed/image")
    for data in (b"old", b"new"):
        path.write_bytes(data)
        fetch([path], fresh=True)
        assert file_sha256(path) == hashlib.sha256(data).hexdigest()
        assert object_bytes(path) == data


def test_files_stay_files() -> None:
    assert as_path("drives/s3:/x") == Path("drives/s3:/x")
    assert not is_remote(as_path(Path("/data/drive")))
