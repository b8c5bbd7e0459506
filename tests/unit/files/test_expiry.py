"""Which files are old enough to go, and what never goes."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

from conetl.files.atomic import LATEST, old_images, old_publications, old_results, remove, size_bytes
from conetl.readers.drives.bags.images import unpack

NOW = datetime.now(UTC)
MONTH_AGO = NOW - timedelta(days=30)


def write(path: Path, *, age_days: float, content: bytes = b"x" * 10) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    seconds = NOW.timestamp() - 86400 * age_days
    os.utime(path, (seconds, seconds))
    return path


def test_results_go_by_age_and_nothing_else_in_their_folder(tmp_path: Path) -> None:
    old = write(tmp_path / "old.parquet", age_days=40)
    write(tmp_path / "new.parquet", age_days=2)
    write(tmp_path / "notes.txt", age_days=40)
    assert old_results(tmp_path, MONTH_AGO) == [old]
    assert old_results(tmp_path / "missing", MONTH_AGO) == []


def test_a_image_that_a_run_asked_for_again_stays(tmp_path: Path) -> None:
    unused, used = (unpack(content, ".png", tmp_path) for content in (b"unused", b"used"))
    for path in (unused, used):
        write(path, age_days=40, content=path.read_bytes())
    assert unpack(b"used", ".png", tmp_path) == used
    assert old_images(tmp_path, MONTH_AGO) == [unused]
    assert (remove([unused, unused]), unused.exists(), used.exists()) == (6, False, True)


def test_old_publications_go_as_a_whole_but_for_the_latest(tmp_path: Path) -> None:
    for name, age_days in (("2026-01-01", 80), ("2026-02-01", 50), ("2026-03-20", 2)):
        write(tmp_path / name / "map.geojson", age_days=age_days)
        write(tmp_path / name / "publication.json", age_days=age_days)
    write(tmp_path / "reports" / "default" / "000001.html", age_days=80)
    (tmp_path / LATEST).symlink_to("2026-02-01")
    old = old_publications(tmp_path, MONTH_AGO)
    assert old == [tmp_path / "2026-01-01"]
    assert size_bytes(old) == remove(old) == 20
    assert sorted(path.name for path in tmp_path.iterdir()) == ["2026-02-01", "2026-03-20", LATEST, "reports"]
