"""Drives whose positions agree with themselves, but not with the other drives of the map."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

import pytest
from pydantic import SecretStr

from conetl.checks.verdict import judge_all
from conetl.db.connection import Connection, connect
from conetl.db.map.decision_store import held_drives
from conetl.model.drive import Drive, DriveRecords
from conetl.model.health import HealthCheck, Verdict
from conetl.model.params import IngestParams
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.commit import commit
from conetl.pipeline.compared.positions import check_positions_on_map
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from tests.integration.small_drives import SAMPLES
from tests.mutants.recordings import aside, farther_east

_SECOND_NS = 10**9


@pytest.fixture(scope="module")
def second(sample_settings: Settings) -> AnalysedDrive:
    return analyse(read_drive(SAMPLES[1])[0], settings=sample_settings)


@pytest.fixture(scope="module")
def first_day(module_database_url: str, sample_settings: Settings) -> Iterator[Connection]:
    """A map of the first sample drive."""
    settings = sample_settings.model_copy(update={"database_url": SecretStr(module_database_url)})
    commit(analyse(read_drive(SAMPLES[0])[0], settings=settings), settings)
    with closing(connect(module_database_url)) as conn:
        yield conn


def at(begin_ns: int) -> Callable[[Drive], Drive]:
    def shifted(drive: Drive) -> Drive:
        later_ns = begin_ns - drive.captured_ns[0]
        pairs = tuple(
            pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + later_ns}) for pair in drive.frame_pairs
        )
        return drive.model_copy(update={"frame_pairs": pairs})

    return shifted


def checks_of(conn: Connection, records: DriveRecords, drive: Drive) -> list[HealthCheck]:
    """Of a drive whose tracks do not matter."""
    changed = records._replace(drive=drive, tracks=[])
    return judge_all(check_positions_on_map(conn, changed, IngestParams(), "default"))


def test_a_good_drive_passes(first_day: Connection, second: AnalysedDrive) -> None:
    assert checks_of(first_day, second.records, second.drive) == []


@pytest.mark.parametrize(("degrees", "where"), [(6.0, "west"), (-6.0, "east")])
def test_a_drive_in_the_next_utm_zone_is_held(
    first_day: Connection, second: AnalysedDrive, degrees: float, where: str
) -> None:
    [check] = checks_of(first_day, second.records, farther_east(degrees)(second.drive))
    assert (check.verdict, check.value) == (Verdict.HOLD, degrees)
    assert f"6 degrees farther {where}, one UTM zone" in check.detail


@pytest.mark.parametrize(("metres", "warned"), [(45_000.0, False), (55_000.0, True)])
def test_a_drive_far_from_all_others_is_a_warning(
    first_day: Connection, second: AnalysedDrive, metres: float, warned: bool
) -> None:
    found = checks_of(first_day, second.records, aside(metres)(second.drive))
    assert [check.verdict for check in found] == [Verdict.NOTE] * warned
    assert not warned or "Nothing else on the map is within 50 km of this drive" in found[0].detail


@pytest.mark.parametrize(("metres", "after_s", "where"), [
    (2_000.0, 0.0, "1.9 km away at the same time"), (2_000.0, 20.0, "1.9 km away 16 s before or after it"),
    (2_000.0, -20.0, "1.9 km away 16 s before or after it"), (100.0, 0.0, ""), (2_000.0, 60.0, ""),
])  # fmt: skip
def test_one_rig_in_two_places_is_a_warning(
    first_day: Connection, second: AnalysedDrive, metres: float, after_s: float, where: str
) -> None:
    begin_ns = read_drive(SAMPLES[0], headers_only=True)[0].captured_ns[0] + round(after_s * _SECOND_NS)
    drive = at(begin_ns)(aside(metres)(second.drive))
    found = checks_of(first_day, second.records, drive)
    assert [check.verdict for check in found] == [Verdict.NOTE] * bool(where)
    if where:
        same = f"Drive 2026-03-02_taper_pass1 has the same rig (rig_id {drive.rig.rig_id})"
        assert f"{same} and was {where}" in found[0].detail
    other = drive.model_copy(update={"rig": drive.rig.model_copy(update={"rig_id": "another van"})})
    assert checks_of(first_day, second.records, other) == []


def test_the_commit_of_a_drive_that_contradicts_the_map_is_on_hold(
    first_day: Connection, second: AnalysedDrive, module_database_url: str, sample_settings: Settings
) -> None:
    """Last in this file: it stays on the map."""
    settings = sample_settings.model_copy(update={"database_url": SecretStr(module_database_url)})
    drive = farther_east(6.0)(second.drive)
    made = commit(replace(second, records=second.records._replace(drive=drive, tracks=[])), settings)
    first_day.rollback()
    assert (made.report.status, made.report.counts_on_map) == ("held", False)
    assert made.report.on_hold is not None and "one UTM zone" in made.report.on_hold
    assert [one.drive_id for one in held_drives(first_day, map_name="default")] == [drive.drive_id]
