"""What people decide lasts: suppressed, pinned, reverted, in any order with drives, and taken back without loss."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import permutations

import pytest

from conetl.db.map.archive import list_maps
from conetl.db.map.decision_store import list_decisions
from conetl.db.map.map_store import (
    feature_log,
    list_changesets,
    map_summary,
    read_current_features,
    read_features_as_of,
)
from conetl.model.errors import ConflictError, InputError
from conetl.model.map_records import DeltaKind
from conetl.model.params import ImportParams
from conetl.pipeline.maps.decisions import CLASSIFY, PIN, SUPPRESS, decide_location, revert
from conetl.pipeline.maps.import_map import import_map
from conetl.readers.maps.imported_rows import read_map_file
from tests.cases import cases
from tests.integration.drives_of_days import RIGS, failed_audits, merge, survey, valid_time_map
from tests.synthetic.world import ORIGIN_M

pytestmark = pytest.mark.usefixtures("audited")


def near(conn, east, north, radius=0.8):
    conn.rollback()
    return [
        feature
        for feature in read_current_features(conn)
        if (feature.xyz_m[0] - ORIGIN_M[0] - east) ** 2 + (feature.xyz_m[1] - ORIGIN_M[1] - north) ** 2 < radius**2
    ]


def test_a_suppressed_place_stays_suppressed_whatever_comes(conn):
    merge(conn, survey(0))
    [feature] = near(conn, 14.0, 3.6)
    known = list_changesets(conn)[0].committed_at
    conn.rollback()
    decided = decide_location(conn, SUPPRESS, str(feature.feature_id), map_name="default", note="a bollard")
    assert decided.versions_written == 1
    assert near(conn, 14.0, 3.6) == []
    for day in (2, 1):
        merge(conn, survey(day))
        assert near(conn, 14.0, 3.6) == []
    assert feature in [v.feature for v in read_features_as_of(conn, known_at=known)]
    assert [d.note for d in list_decisions(conn)] == ["a bollard"]
    [log] = {row["suppressed"] for row in feature_log(conn, feature.feature_id) if row["known_to"] is None}
    assert log is True
    conn.rollback()
    with pytest.raises(InputError, match="already"):
        decide_location(conn, SUPPRESS, str(feature.feature_id), map_name="default")
    for kind, category in ((PIN, None), (CLASSIFY, "drum")):
        with pytest.raises(ConflictError, match=f"suppressed.* no effect.*`conetl map revert {decided.decision_id}`"):
            decide_location(conn, kind, str(feature.feature_id), category=category, map_name="default")
    revert(conn, str(decided.decision_id)[:8], map_name="default")
    [back] = near(conn, 14.0, 3.6)
    assert back.observation_count > feature.observation_count, "drives went on counting it"
    assert list_decisions(conn) == []


def test_a_map_tells_when_it_was_last_decided_about(conn):
    """Whoever asks whether a map changed since yesterday must see a person's decision, and that it was taken back."""
    merge(conn, survey(0))
    feature = read_current_features(conn)[0]
    conn.rollback()

    def told():
        [served] = list_maps(conn)
        summary = map_summary(conn)
        conn.rollback()
        assert served["last_committed_at"] == summary["last_committed_at"]
        return summary["last_committed_at"]

    committed = told()
    decided = decide_location(conn, PIN, str(feature.feature_id), map_name="default")
    assert committed < told() == decided.decided_at
    revert(conn, str(decided.decision_id), map_name="default")
    assert told() > decided.decided_at


def test_a_decision_reaches_the_cones_of_others_within_its_radius(conn, tmp_path):
    """An import whose area does not hold the centre of the place, but whose cone is within the radius."""
    first = one_cone(conn, tmp_path / "a.csv", 458005.0)
    second = one_cone(conn, tmp_path / "b.csv", 458024.0)
    decided = decide_location(conn, SUPPRESS, str(first), map_name="default", radius_m=20.0)
    assert decided.versions_written == 2
    assert read_current_features(conn) == []
    conn.rollback()
    assert failed_audits(conn) == []
    revert(conn, str(decided.decision_id), map_name="default")
    assert {feature.feature_id for feature in read_current_features(conn)} == {first, second}
    conn.rollback()
    narrow = decide_location(conn, SUPPRESS, str(first), map_name="default", radius_m=18.9)
    assert (narrow.versions_written, [f.feature_id for f in read_current_features(conn)]) == (1, [second])


def one_cone(conn, path, easting_m):
    """A map of one cone, imported; the cone's id."""
    path.write_text(f"easting_m,northing_m,ellipsoidal_height_m\n{easting_m},5428005.0,115.0\n")
    options = {"crs": "EPSG:32632", "map_srid": 32632, "stated_at": datetime(2026, 3, 1, tzinfo=UTC)}
    before = {feature.feature_id for feature in read_current_features(conn)}
    conn.rollback()
    import_map(conn, read_map_file(path, ImportParams(), **options), ImportParams(), map_name="default")
    [founded] = {feature.feature_id for feature in read_current_features(conn)} - before
    conn.rollback()
    return founded


def test_a_pin_that_comes_after_the_removal_brings_the_cone_back(conn):
    for day in (0, 1):
        merge(conn, survey(day))
        if day == 0:
            [feature] = near(conn, 34.0, 2.0)
    assert near(conn, 34.0, 2.0) == []
    conn.rollback()
    before = valid_time_map(conn)
    decided = decide_location(conn, PIN, str(feature.feature_id), map_name="default")
    assert decided.replayed == 2
    [back] = near(conn, 34.0, 2.0)
    assert (back.feature_id, back.version, back.xyz_m) == (feature.feature_id, feature.version, feature.xyz_m)
    revert(conn, str(decided.decision_id), map_name="default")
    assert valid_time_map(conn) == before


def test_a_class_that_a_person_states_holds_for_all_drives_and_is_taken_back(conn):
    merge(conn, survey(0))
    [feature] = near(conn, 34.0, 2.0)  # taken away before the second day
    conn.rollback()
    before = valid_time_map(conn)
    decided = decide_location(conn, CLASSIFY, str(feature.feature_id), category="drum", map_name="default")
    [drum] = near(conn, 34.0, 2.0)
    assert drum == feature.model_copy(update={"category": "drum"})
    conn.rollback()
    with pytest.raises(ConflictError, match="already"):
        decide_location(conn, CLASSIFY, str(feature.feature_id), category="barricade", map_name="default")
    revert(conn, str(decided.decision_id), map_name="default")
    assert valid_time_map(conn) == before
    decide_location(conn, CLASSIFY, str(feature.feature_id), category="drum", map_name="default")
    merged = merge(conn, survey(1))
    assert {d.kind for d in merged.changeset.deltas if d.feature_id == feature.feature_id} == {DeltaKind.REMOVED}, (
        "the detector takes it for a cone, and no cone is there any more"
    )
    [other] = near(conn, 14.0, 3.6)
    with pytest.raises(InputError, match="is a traffic_cone; expected another class: tubular_marker, drum"):
        decide_location(conn, CLASSIFY, str(other.feature_id), category="lamp", map_name="default")


@pytest.mark.parametrize("day", cases(1, release=[0]))
def test_a_reverted_drive_might_never_have_come_and_comes_back_as_it_was(conn, another_database, day):
    """It takes along its calibration, too, which others have in common with it."""
    for one in range(3):
        merge(conn, survey(one, rig=RIGS[one]))
    everything = valid_time_map(conn)
    changesets = {changeset.drive_id: changeset for changeset in list_changesets(conn)}
    conn.rollback()
    target = changesets[survey(day).drive.drive_id]
    reverted = revert(conn, str(target.changeset_no), map_name="default", note="bad GNSS")
    assert reverted.replayed == 2 - day
    assert bool(reverted.conflicts) == (day < 2), "features that later drives saw too are named"
    for conflict in reverted.conflicts:
        assert conflict.changed_to is not None
        assert conflict.changed_to.changeset_id == target.changeset_id or conflict.kind in ("missed", "confirmed")
        assert (conflict.was is None) == (conflict.kind in ("added", "split"))
        assert conflict.is_now is None or conflict.is_now.changeset_id != target.changeset_id
    with another_database() as other:
        for one in {0, 1, 2} - {day}:
            merge(other, survey(one, rig=RIGS[one]))
        assert valid_time_map(other) == valid_time_map(conn)
    assert merge(conn, survey(day, rig=RIGS[day])) is None, "ingested again, it stays reverted"
    with pytest.raises(InputError, match="already"):
        revert(conn, str(target.changeset_id), map_name="default")
    restored = revert(conn, str(reverted.decision_id), map_name="default")
    assert restored.kind == "withdraw"
    assert valid_time_map(conn) == everything
    with pytest.raises(InputError, match="no longer active"):
        revert(conn, str(reverted.decision_id), map_name="default")


def test_decisions_and_drives_in_any_order_give_one_map(another_database, conn):
    """Day 0 first, so that there is something to decide about; then two drives and three decisions in any order."""
    merge(conn, survey(0))
    [pinned], [suppressed] = near(conn, 34.0, 2.0), near(conn, 14.0, 3.6)
    expected = None
    orders = list(permutations(("1", "2", "pin", "suppress", "revert")))
    for order in orders[::60]:
        with another_database() as other:
            merge(other, survey(0))
            merge(other, survey(3))
            for step in order:
                if step.isdigit():
                    merge(other, survey(int(step)))
                elif step == "revert":
                    revert(other, "2", map_name="default")  # the drive of day 3
                else:
                    about = pinned if step == "pin" else suppressed
                    place_of_first_day(other, step, about, order)
            found = valid_time_map(other)
            assert failed_audits(other) == []
            expected = expected or found
            assert found == expected


def place_of_first_day(conn, kind, feature, order):
    """The same decision in every order: about the place where the first drive saw the cone."""
    from conetl.model.map_records import Location
    from conetl.pipeline.maps.decisions import _judge_location, _open_decision

    with _open_decision(conn, "default", " ".join(order), None, lock_timeout_s=60.0) as at:
        place = Location(xy_m=feature.xyz_m[:2], radius_m=1.0)
        at.insert(kind, location=place)
        _judge_location(conn, at, kind, place)
