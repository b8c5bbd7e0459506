from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from conetl.files.parquet_store import file_sha256, has_result, load_result, load_results, result_key, save_result
from conetl.model.drive import Detection, Position
from conetl.model.errors import StorageError
from conetl.model.rejections import Rejection, RejectionReason
from tests import records


def detection(index: int) -> Detection:
    return records.box(10.1, 20.2, 7.0 / 3, 12.0, frame=3, index=index)


REJECTION = Rejection(
    step="detections",
    reason=RejectionReason.IMAGE_TRUNCATED,
    record="frame pair 3",
    detail="cut off",
    payload={"frame_index": 3},
)


def test_records_and_rejections_come_back_equal(tmp_path: Path) -> None:
    key = result_key("a", "b")
    assert not has_result(tmp_path, key)
    path = save_result(tmp_path, key, [detection(0), detection(1)], [REJECTION])
    assert has_result(tmp_path, key)
    assert load_result(path, Detection) == ([detection(0), detection(1)], [REJECTION])
    assert [p.name for p in tmp_path.iterdir()] == [path.name], "nothing is left aside"


def test_an_empty_chunk_is_a_result_too(tmp_path: Path) -> None:
    path = save_result(tmp_path, result_key("empty"), [], [])
    assert load_result(path, Detection) == ([], [])


def test_chunks_are_read_in_order(tmp_path: Path) -> None:
    paths = [save_result(tmp_path, result_key(str(i)), [detection(i)], [REJECTION]) for i in range(3)]
    records, rejections = load_results(paths, Detection)
    assert [d.detection_index for d in records] == [0, 1, 2]
    assert len(rejections) == 3


def test_a_file_of_other_records_is_refused(tmp_path: Path) -> None:
    path = save_result(tmp_path, result_key("x"), [detection(0)], [])
    with pytest.raises(StorageError, match=rf"{path.name}: .* damaged, or of another version.* Remove the folder"):
        load_result(path, Position)
    path.write_bytes(path.read_bytes()[:100])  # since it was written
    with pytest.raises(StorageError, match=path.name):
        load_result(path, Detection)


def test_keys_depend_on_every_part_and_their_order() -> None:
    keys = {result_key("a", "b"), result_key("b", "a"), result_key("ab"), result_key("a", "b", "")}
    assert len(keys) == 4


def test_a_missing_file_has_a_hash_of_its_own(tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.write_bytes(b"x")
    assert file_sha256(there) != file_sha256(tmp_path / "missing")


@pytest.mark.parametrize(
    "damage", [lambda b: b[:100], lambda b: b"", lambda b: b"not parquet", lambda b: b[:60] + b"\0" * 40 + b[100:]]
)
def test_a_damaged_file_is_no_result_and_is_computed_again(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    key = result_key("x")
    path = save_result(tmp_path, key, [detection(0), detection(1)], [])
    path.write_bytes(damage(path.read_bytes()))
    assert not has_result(tmp_path, key)
    assert load_result(save_result(tmp_path, key, [detection(0)], []), Detection)[0] == [detection(0)]


def test_a_foreign_parquet_file_is_no_result(tmp_path: Path) -> None:
    key = result_key("x")
    pq.write_table(pa.table({"a": [1]}), tmp_path / f"{key}.parquet")
    assert not has_result(tmp_path, key)
