"""`conetl backfill --here`: many drives on one machine where nothing of `conetl up` runs."""

from __future__ import annotations

import json
import os
import time
from contextlib import closing
from functools import partial
from pathlib import Path

from conetl.db.connection import connect, execute
from tests.command import conetl
from tests.integration.small_drives import SAMPLES, cut_drive, processes_with

#: 210 bytes.
LONG_ID = "漢" * 70


def _backfill(root: Path, home: Path, database_url: str, *options: str) -> tuple[int, dict[str, dict[str, object]]]:
    """Exit code, and by drive id what became of the drives; the plan's lines where there was nothing to do."""
    words = ("backfill", root.name, "--here", "--json", *options)
    done = conetl(*words, cwd=root.parent, CONETL_HOME=home, CONETL_DATABASE_URL=database_url)
    assert done.stdout, done.stderr
    said = json.loads(done.stdout)
    return done.returncode, {d["drive_id"]: d for d in said["drives"] or said["plan"]["lines"]}


def test_a_backfill_without_services_leaves_nothing_but_the_map_and_its_receipts(
    tmp_path: Path, database_url: str
) -> None:
    cut_drive(SAMPLES[0], tmp_path / "drives" / "2026-05-01_good", "2026-05-01")
    cut_drive(SAMPLES[1], tmp_path / "drives" / "2026-05-02_poisoned", "2026-05-02", poisoned=True)
    cut_drive(SAMPLES[1], tmp_path / "drives" / "2026-05-03_good", "2026-05-03")
    backfill = partial(_backfill, tmp_path / "drives", tmp_path / "home", database_url)
    code, drives = backfill("--max-parallel", "2")
    assert {name: drive["state"] for name, drive in drives.items()} == {
        "2026-05-01_good": "committed", "2026-05-02_poisoned": "failed", "2026-05-03_good": "committed",
    }  # fmt: skip
    assert "not one usable pose" in str(drives["2026-05-02_poisoned"]["reason"])
    assert code == 2
    with closing(connect(database_url)) as conn:
        changesets = execute(
            conn, "select d.drive_id from conetl.changeset c join conetl.drive d using (drive_uuid) order by 1"
        )
        cones = execute(conn, "select count(*) as cones from conetl.feature_version")[0]["cones"]
        states = {r["drive_id"]: r["state"] for r in execute(conn, "select * from conetl.latest_receipt")}
    assert [row["drive_id"] for row in changesets] == ["2026-05-01_good", "2026-05-03_good"]
    assert cones > 0
    assert states == {name: drive["state"] for name, drive in drives.items()}
    ends = time.monotonic() + 30
    while processes_with("CONETL_HOME", tmp_path / "home") and time.monotonic() < ends:
        time.sleep(0.2)  # the temporary server takes a moment to end
    assert processes_with("CONETL_HOME", tmp_path / "home") == set()

    for pose in (
        tmp_path / "drives" / "2026-05-03_good" / "oxts" / "data"
    ).iterdir():  # corrected, as post-processing does
        lat_deg, *others = pose.read_text().split()
        pose.write_text(" ".join([f"{float(lat_deg) + 4.5e-6:.12f}", *others]))
    code, drives = backfill("--dry-run")
    assert code == 0
    assert {name: drive["action"] for name, drive in drives.items()} == {
        "2026-05-01_good": "skip", "2026-05-02_poisoned": "ingest", "2026-05-03_good": "ingest",
    }  # fmt: skip
    assert "changed since" in str(drives["2026-05-03_good"]["why"])


def test_a_folder_of_links_to_drives_is_ingested_once(tmp_path: Path, database_url: str) -> None:
    """Links by other names, and one drive whose calibration lies beside the link only."""
    here, beside = (
        cut_drive(SAMPLES[n], tmp_path / f"disk{n}" / f"2026-05-0{n + 1}_run", f"2026-05-0{n + 1}") for n in (0, 1)
    )
    links = tmp_path / "links"
    links.mkdir()
    for calibration in beside.glob("calib*.txt"):
        calibration.rename(links / calibration.name)
    for name, drive in (("monday", here), ("monday-again", here), ("tuesday", beside)):
        (links / name).symlink_to(drive)
    backfill = partial(_backfill, links, tmp_path / "home", database_url)

    code, drives = backfill()
    assert {name: drive["state"] for name, drive in drives.items()} == {
        "2026-05-01_run": "committed", "2026-05-02_run": "committed",
    }  # fmt: skip
    assert code == 0
    code, drives = backfill()
    assert {name: drive["action"] for name, drive in drives.items()} == {
        "2026-05-01_run": "skip", "2026-05-02_run": "skip",
    }  # fmt: skip
    assert code == 0
    with closing(connect(database_url)) as conn:
        assert execute(conn, "select count(*) as n from conetl.changeset")[0]["n"] == 2


def test_one_odd_folder_does_not_stop_the_drives_beside_it(tmp_path: Path, database_url: str) -> None:
    """A name that is not UTF-8, an id of more bytes than a file name may have, a first stamp before all times."""
    drives = tmp_path / "drives"
    cut_drive(SAMPLES[1], drives / os.fsdecode(b"M\xfcnchen"), "2026-05-01")
    odd = cut_drive(SAMPLES[0], drives / "2026-05-02", "2026-05-02")
    (odd / "drive.yaml").write_text(f"drive_id: {LONG_ID}\ntimestamps_timezone: Europe/Berlin\n", encoding="utf-8")
    stamps = odd / "image_02" / "timestamps.txt"
    stamps.write_text("0001-01-01 00:00:00\n" + stamps.read_text().partition("\n")[2])
    backfill = partial(_backfill, drives, tmp_path / "home", database_url)
    code, planned = backfill("--dry-run")
    assert {name: line["action"] for name, line in planned.items()} == {"M\\xfcnchen": "refuse", LONG_ID: "ingest"}
    assert code == 0
    code, done = backfill()
    assert {name: drive["state"] for name, drive in done.items()} == {"M\\xfcnchen": "failed", LONG_ID: "committed"}
    assert "not UTF-8" in str(done["M\\xfcnchen"]["reason"])
    assert code == 2
