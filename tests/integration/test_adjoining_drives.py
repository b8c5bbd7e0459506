"""A recording that was cut where GNSS jumps: no part counts, whatever order they come in, until something says which is right."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cache, partial
from hashlib import sha256
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.db.connection import connect, execute
from conetl.db.map.decision_store import held_drives
from conetl.db.map.map_store import list_changesets, read_current_features
from conetl.model.drive import Drive
from conetl.model.errors import DatabaseError
from conetl.model.health import ADJOINING
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.commit import commit
from conetl.pipeline.maps.decisions import accept_drive, revert
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from tests.cases import cases
from tests.conftest import cloned_database
from tests.integration.drives_of_days import failed_audits, valid_time_map
from tests.integration.small_drives import SAMPLES
from tests.mutants.recordings import jump

_DAY_NS = 86_400_000_000_000
Parts = Callable[[str], AnalysedDrive]
WRONG = ("wrong_0", "wrong_1", "wrong_2")


def part(drive: Drive, name: str, first: int, last: int, later_ns: int = 0) -> Drive:
    pairs = tuple(
        pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + later_ns})
        for pair in drive.frame_pairs[first:last]
    )
    content = sha256(f"{name} {drive.content_sha256}".encode()).hexdigest()
    changes = {"drive_id": name, "frame_pairs": pairs, "content_sha256": content, "expected_frame_count": len(pairs)}
    return drive.model_copy(update=changes)


@pytest.fixture(scope="module")
def parts(sample_settings: Settings) -> Parts:
    """Three parts of a drive, the same ones with a jump of 50 m before the second, and the whole drive a day before;
    corrected_1 is the second one delivered again without the jump. Each is analysed when a test asks for it."""
    good = read_drive(SAMPLES[0])[0]
    wrong = jump(50.0, 15)(good)
    cut = ((0, 15), (15, 27), (27, 39))
    drives = [
        *(part(good, f"good_{k}", *ends) for k, ends in enumerate(cut)),
        *(part(wrong, f"wrong_{k}", *ends) for k, ends in enumerate(cut)),
        part(good, "day_before", 0, 39, -_DAY_NS),
        part(good, "corrected_1", *cut[1]).model_copy(update={"drive_id": "wrong_1"}),
    ]
    names = [drive.drive_id for drive in drives[:-1]] + ["corrected_1"]
    named = dict(zip(names, drives, strict=True))
    return cache(lambda name: analyse(named[name], settings=sample_settings))


@pytest.fixture
def settings(database_url: str, sample_settings: Settings) -> Settings:
    return sample_settings.model_copy(update={"database_url": SecretStr(database_url)})


def in_database(settings: Settings, of: Any) -> Any:
    """What a function says of the map."""
    assert settings.database_url is not None
    with closing(connect(settings.database_url.get_secret_value())) as conn:
        found = of(conn)
        conn.rollback()
        assert failed_audits(conn) == []
        return found


def held(settings: Settings) -> set[str]:
    found = in_database(settings, partial(held_drives, map_name="default"))
    assert {check.name for drive in found for check in drive.checks} <= {ADJOINING}
    return {drive.drive_id for drive in found}


def cones(settings: Settings) -> int:
    return len(in_database(settings, read_current_features))


def accept(settings: Settings, drive_id: str) -> Any:
    return in_database(settings, partial(accept_drive, drive=drive_id, map_name="default"))


@pytest.mark.release
def test_parts_of_one_recording_that_fit_count(settings: Settings, parts: Parts) -> None:
    for name in ("good_1", "good_0", "good_2"):
        assert commit(parts(name), settings).report.on_hold is None
    assert not held(settings) and cones(settings) >= 9


@pytest.mark.parametrize(
    "order", cases((WRONG,), release=[(WRONG[::-1],), (("wrong_1", "wrong_0", "wrong_2"),)]), ids="-".join
)
def test_parts_on_both_sides_of_a_jump_are_held(settings: Settings, parts: Parts, order: Sequence[str]) -> None:
    reports = [commit(parts(name), settings).report for name in order]
    assert held(settings) == set(order) and cones(settings) == 0
    jumps = [check.value for report in reports for check in report.health if check.name == ADJOINING and check.value]
    assert jumps and np.allclose(jumps, 50.0, atol=1.0)
    named = {change.drive_id for report in reports for change in report.hold_changes}
    on_hold_at_once = {report.drive_id for report in reports if report.on_hold}
    assert named | on_hold_at_once == set(order)


def test_the_part_that_a_person_accepts_counts(settings: Settings, parts: Parts) -> None:
    for name in ("wrong_0", "wrong_1"):
        commit(parts(name), settings)
    accept(settings, "wrong_0")
    assert held(settings) == {"wrong_1"} and cones(settings) > 0
    commit(parts("wrong_2"), settings)
    assert held(settings) == {"wrong_1", "wrong_2"}


def test_the_part_that_the_map_confirms_counts(settings: Settings, parts: Parts) -> None:
    for name in ("day_before", "wrong_0", "wrong_1"):
        commit(parts(name), settings)
    assert held(settings) == {"wrong_1"} and cones(settings) == 9


def number_of(settings: Settings, drive_id: str) -> str:
    return in_database(
        settings, lambda conn: next(str(c.changeset_no) for c in list_changesets(conn) if c.drive_id == drive_id)
    )


@pytest.fixture(scope="module")
def map_of(cluster_url: str, template_database: str, sample_settings: Settings, parts: Parts) -> Any:
    """The map and the drives on hold after some steps: names of parts to commit, or functions of the settings."""

    def make(*steps: Any) -> Any:
        with cloned_database(cluster_url, template_database) as url:
            settings = sample_settings.model_copy(update={"database_url": SecretStr(url)})
            for step in steps:
                step(settings) if callable(step) else commit(parts(step), settings)
            return held(settings), in_database(settings, valid_time_map)

    return make


def test_the_map_is_the_same_in_every_order(map_of: Any) -> None:
    orders = [*permutations(("day_before", *WRONG))]
    in_order = map_of(*orders[0])
    assert in_order[0] == {"wrong_1", "wrong_2"}
    assert [map_of(*order) == in_order for order in orders[11::12]] == [True] * 2


@pytest.mark.parametrize("order", cases((WRONG[::-1],), release=[(WRONG,)]), ids="-".join)
def test_a_corrected_part_ends_the_holds(map_of: Any, order: Sequence[str]) -> None:
    """With the last part as it was, the jump is one part later."""
    assert map_of(*order, "corrected_1")[0] == set(WRONG)
    on_hold, found = map_of(*(name for name in order if name != "wrong_2"), "corrected_1")
    assert on_hold == set()
    assert found["versions"] and found == map_of("wrong_0", "wrong_1", "corrected_1")[1]


def test_the_rig_id_that_the_hold_advises_ends_the_holds(settings: Settings, parts: Parts) -> None:
    for name in ("wrong_0", "wrong_1"):
        said = commit(parts(name), settings).report.on_hold
    assert said is not None and "rig_id: NAME" in said and "ingest that drive again" in said
    drive = parts("wrong_0").drive
    named = drive.model_copy(
        update={"rig": drive.rig.model_copy(update={"rig_id": "van-2"}), "content_sha256": "0" * 64}
    )
    commit(replace(parts("wrong_0"), records=parts("wrong_0").records._replace(drive=named)), settings)
    assert not held(settings) and cones(settings) > 4


def test_a_reverted_part_ends_the_holds(map_of: Any) -> None:
    def revert_it(settings: Settings) -> None:
        number = number_of(settings, "wrong_1")
        in_database(settings, partial(revert, what=number, map_name="default"))

    on_hold, found = map_of("wrong_1", "wrong_0", revert_it)
    assert on_hold == set() and found["versions"]
    assert found == map_of("wrong_0")[1]


@pytest.mark.parametrize("order", cases((WRONG,), release=[(WRONG[::-1],)]), ids="-".join)
def test_what_continues_an_accepted_part_counts(map_of: Any, order: Sequence[str]) -> None:
    on_hold, found = map_of(*order, partial(accept, drive_id="wrong_1"))
    assert on_hold == {"wrong_0"}
    early = [name for name in order if name != "wrong_2"]
    assert (on_hold, found) == map_of(*early, partial(accept, drive_id="wrong_1"), "wrong_2")

    def withdraw(settings: Settings) -> None:
        outcome = accept(settings, "wrong_1")
        in_database(settings, partial(revert, what=str(outcome.decision_id), map_name="default"))

    assert map_of(*order, withdraw)[0] == set(WRONG)


def test_what_was_accepted_and_is_no_longer_holds_what_it_continues(map_of: Any) -> None:
    """Nothing contradicts the last part itself; the one before it counted because it was accepted."""

    def accept_and_withdraw(settings: Settings) -> None:
        outcome = accept(settings, "wrong_2")
        assert held(settings) == {"wrong_0"}
        in_database(settings, partial(revert, what=str(outcome.decision_id), map_name="default"))

    assert map_of(*WRONG, accept_and_withdraw)[0] == set(WRONG)


def test_a_part_is_held_in_the_transaction_of_the_one_that_contradicts_it(settings: Settings, parts: Parts) -> None:
    """What would be left by a kill in between: a wrong part that counts, and that nothing looks at again."""
    first = commit(parts("wrong_0"), settings)
    in_database(
        settings,
        lambda conn: execute(
            conn,
            "create function conetl.fail() returns trigger language plpgsql as $$ begin raise exception 'killed'; end $$; "
            "create trigger fail before insert on conetl.hold for each row "
            f"when (new.changeset_id = '{first.changeset.changeset_id}') execute function conetl.fail(); commit",
        ),
    )
    with pytest.raises(DatabaseError, match="killed"):
        commit(parts("wrong_1"), settings)
    assert in_database(settings, lambda conn: len(list_changesets(conn))) == 1
