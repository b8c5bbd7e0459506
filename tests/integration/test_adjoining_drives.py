"""A recording that was cut where GNSS jumps: no part counts, whatever order they come in, until something says which is right."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from hashlib import sha256
from itertools import permutations

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.db.connection import connect
from conetl.db.map.decision_store import held_drives
from conetl.db.map.map_store import read_current_features
from conetl.model.health import ADJOINING
from conetl.model.records import Drive
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.commit import commit
from conetl.pipeline.maps.decisions import accept_drive
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from tests.integration.small_drives import SAMPLES
from tests.mutants.recordings import jump

_DAY_NS = 86_400_000_000_000


def part(drive: Drive, name: str, first: int, last: int, later_ns: int = 0) -> Drive:
    pairs = tuple(
        pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + later_ns})
        for pair in drive.frame_pairs[first:last]
    )
    content = sha256(f"{name} {drive.content_sha256}".encode()).hexdigest()
    changes = {"drive_id": name, "frame_pairs": pairs, "content_sha256": content, "expected_frame_count": len(pairs)}
    return drive.model_copy(update=changes)


@pytest.fixture(scope="module")
def parts(sample_settings: Settings) -> dict[str, AnalysedDrive]:
    """Three parts of a drive, the same ones with a jump of 50 m before the second, and the whole drive a day before."""
    good = read_drive(SAMPLES[0])[0]
    wrong = jump(50.0, 15)(good)
    cut = ((0, 15), (15, 27), (27, 39))
    drives = [
        *(part(good, f"good_{k}", *ends) for k, ends in enumerate(cut)),
        *(part(wrong, f"wrong_{k}", *ends) for k, ends in enumerate(cut)),
        part(good, "day_before", 0, 39, -_DAY_NS),
    ]
    return {drive.drive_id: analyse(drive, settings=sample_settings) for drive in drives}


@pytest.fixture
def settings(database_url: str, sample_settings: Settings) -> Settings:
    return sample_settings.model_copy(update={"database_url": SecretStr(database_url)})


def held(settings: Settings) -> set[str]:
    assert settings.database_url is not None
    with closing(connect(settings.database_url.get_secret_value())) as conn:
        found = held_drives(conn, map_name="default")
        assert {check.name for drive in found for check in drive.checks} <= {ADJOINING}
        return {drive.drive_id for drive in found}


def cones(settings: Settings) -> int:
    assert settings.database_url is not None
    with closing(connect(settings.database_url.get_secret_value())) as conn:
        return len(read_current_features(conn))


def test_parts_of_one_recording_that_fit_count(settings: Settings, parts: dict[str, AnalysedDrive]) -> None:
    for name in ("good_1", "good_0", "good_2"):
        assert commit(parts[name], settings).report.on_hold is None
    assert not held(settings) and cones(settings) >= 9


@pytest.mark.parametrize("order", [*permutations(("wrong_0", "wrong_1", "wrong_2"))], ids="-".join)
def test_parts_on_both_sides_of_a_jump_are_held(
    settings: Settings, parts: dict[str, AnalysedDrive], order: Sequence[str]
) -> None:
    reports = [commit(parts[name], settings).report for name in order]
    assert held(settings) == set(order) and cones(settings) == 0
    jumps = [check.value for report in reports for check in report.health if check.name == ADJOINING and check.value]
    assert jumps and np.allclose(jumps, 50.0, atol=1.0)
    named = {change.drive_id for report in reports for change in report.hold_changes}
    on_hold_at_once = {report.drive_id for report in reports if report.on_hold}
    assert named | on_hold_at_once == set(order)


def test_the_part_that_a_person_accepts_counts(settings: Settings, parts: dict[str, AnalysedDrive]) -> None:
    for name in ("wrong_0", "wrong_1"):
        commit(parts[name], settings)
    assert settings.database_url is not None
    with closing(connect(settings.database_url.get_secret_value())) as conn:
        accept_drive(conn, "wrong_0", map_name="default")
    assert held(settings) == {"wrong_1"} and cones(settings) > 0
    commit(parts["wrong_2"], settings)
    assert held(settings) == {"wrong_1", "wrong_2"}


def test_the_part_that_the_map_confirms_counts(settings: Settings, parts: dict[str, AnalysedDrive]) -> None:
    for name in ("day_before", "wrong_0", "wrong_1"):
        commit(parts[name], settings)
    assert held(settings) == {"wrong_1"} and cones(settings) == 9
