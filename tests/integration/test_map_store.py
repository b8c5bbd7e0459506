"""The map store on a real PostGIS: commits, versions, history, conflicts, kills."""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime, timedelta
from pathlib import Path
from unittest.mock import patch
from uuid import UUID, uuid4

import numpy as np
import pytest

from conetl.db.connection import execute
from conetl.db.map import map_store as store
from conetl.db.map import replay_store
from conetl.db.map.commit import commit_changeset, path_wkt
from conetl.db.map.decision_store import find_decisions
from conetl.db.map.drive_store import drives_at_the_same_time, read_evidence
from conetl.db.map.replay_store import read_open_version, read_versions
from conetl.db.map.results import DriveRef, RunInfo
from conetl.mapping.history import MapUpdate
from conetl.model.base import SharedErrorJacobian, utc_from_ns
from conetl.model.drive import DriveRecords
from conetl.model.errors import DatabaseError, MapMismatchError
from conetl.model.map_records import DeltaKind
from conetl.model.rejections import Rejection, RejectionReason
from conetl.pipeline.replay import replay_of_newest
from tests.synthetic.world import make_path

DAY = timedelta(days=1)


#: Whatever a test does, the map must pass its audits afterwards.
pytestmark = pytest.mark.usefixtures("audited")


def standing(conn, **options):
    return [(v.feature.version, v.valid_from, v.valid_to) for v in store.read_features_as_of(conn, **options)]


def test_first_drive_makes_the_map(conn, samples):
    assert store.find_map(conn) is None
    assert store.map_summary(conn) is None
    assert store.read_current_features(conn) == []
    feature = samples.feature()
    result = samples.commit(conn, samples.added(feature), key="1")
    assert (result.change_counts.points, result.position_count) == ({DeltaKind.ADDED: 1}, 3)
    assert store.read_current_features(conn) == [feature]
    summary = store.map_summary(conn)
    assert (summary["srid"], summary["feature_count"], summary["changeset_count"]) == (samples.SRID, 1, 1)
    assert store.find_changeset(conn, "1" * 64) == result
    assert store.list_changesets(conn) == [result]
    [entry] = store.feature_log(conn, feature.feature_id)
    assert (entry["kind"], entry["new_version"], entry["ellipsoidal_height_m"]) == ("added", 1, 114.5)


def test_raw_records_come_back_as_they_were(conn, samples):
    samples.commit(conn, samples.added(samples.feature()), key="1")
    [pair] = execute(conn, "select *, ST_AsEWKT(geom) as place from frame_pair where frame_index = 1")
    assert pair["captured_at_ns"] == samples.START_NS + 100_000_007
    assert pair["left_path"] == "image_02/data/0000000001.png"
    assert pair["place"] == "SRID=32632;POINT(458000.5 5428000.25 115.125)"
    assert (pair["map_r_body"], pair["sigma_enu_m"]) == ([1, 0, 0, 0, 1, 0, 0, 0, 1], [0.3, 0.3, 0.5])
    assert len(execute(conn, "select 1 from detection where side = 'right' and w_px = 20 and h_px = 30")) == 2
    indices = execute(
        conn, "select left_detection_index, right_detection_index as right from stereo_match order by frame_index"
    )
    assert [tuple(row.values()) for row in indices] == [(0, 0), (0, None), (0, 0)], (
        "one is found in the left image only"
    )
    [match] = execute(conn, "select * from stereo_match where frame_index = 2")
    assert (match["foot_right_u_px"], match["tip_left_v_px"], match["refined"]) == (580, 180, True)
    [position] = execute(conn, "select *, ST_Z(centre_geom) as centre_z from position where frame_index = 0")
    assert (position["cov_yy"], position["camera_z_m"], position["centre_z"]) == (0.02, 12, 114.85)
    [track] = execute(conn, "select * from track")
    assert (track["relative_cov_zz"], track["last_seen_ns"]) == (0.04, samples.START_NS + 200_000_007)
    assert len(execute(conn, "select 1 from track_member where track_index = 0")) == 3


def test_lane_markings_come_back_to_the_last_bit(conn, samples):
    at_m = np.array([458_001.0, 5_428_010.0, 114.5])
    vertices_m = at_m + np.linspace(0, 9.9, 5)[:, None] * [1 / 3, 2 / 3, 0.01]
    dashed = samples.marking(
        vertices_m,
        cov_m2=(1 / 3, 1e-17, -1 / 7, 0.1, 0.0, 0.3),
        pattern="dashed",
        dash_m=1 / 3,
        gap_m=9.1,
        colour="yellow",
    )
    jacobian = SharedErrorJacobian((uuid4(),), np.linspace(0, 0.1, 6).astype(">f4").tobytes())
    track = samples.marking_track(dashed, shared_jacobian=jacobian)
    line, cone = samples.line_feature(dashed, shared_jacobian=jacobian), samples.feature()
    result = samples.commit(conn, samples.added(line), samples.added(cone), key="1", markings=[track])
    assert result.marking_count == 1
    [stored] = read_evidence(conn, [DriveRef(result.drive_uuid, result.changeset_id, "1")])
    assert stored.markings == [track]
    assert {f.feature_id: f for f in store.read_current_features(conn, lines=True)} == {
        f.feature_id: f for f in (line, cone)
    }

    wider = samples.changed(
        "confirmed", line, samples.START_NS + samples.DAY_NS, marking=dashed.model_copy(update={"width_m": 0.15})
    )
    gone = samples.removed(wider.new, samples.START_NS + 2 * samples.DAY_NS)
    samples.commit(conn, wider, key="2", markings=[track], start_ns=samples.START_NS + samples.DAY_NS)
    assert read_open_version(conn, "default", line.feature_id).feature == wider.new
    samples.commit(conn, gone, key="3", start_ns=samples.START_NS + 2 * samples.DAY_NS)
    [before] = [
        v.feature
        for v in store.read_features_as_of(conn, utc_from_ns(gone.changed_at_ns) - DAY / 2, lines=True)
        if v.feature.marking
    ]
    assert before == wider.new and store.read_current_features(conn) == [cone]
    versions, _ = read_versions(conn, [result.drive_uuid])
    assert [v.feature for v in versions if v.feature.marking] == [
        line, wider.new, wider.new.model_copy(update={"version": 3, "missed_count": 1, "existence_probability": 0.05}),
    ]  # fmt: skip


def test_a_cone_that_comes_back_goes_on_counting(conn, samples):
    feature, day = samples.feature(), samples.DAY_NS
    samples.commit(conn, samples.added(feature), key="1")
    samples.commit(conn, samples.removed(feature, samples.START_NS + day), key="2")
    back = samples.feature(seen_ns=samples.START_NS + 2 * day, version=3, seen_count=2, missed_count=1)
    samples.commit(conn, samples.added(back), key="3")
    assert store.read_current_features(conn) == [back]
    assert [len(standing(conn, valid_at=utc_from_ns(samples.START_NS) + n * DAY)) for n in (0, 1, 2)] == [1, 0, 1]


def test_a_change_dated_before_the_open_version_begins_just_after_it(conn, samples):
    """Drives that overlap in time: no state is lost, and the earlier state is kept."""
    feature = samples.feature()
    samples.commit(conn, samples.added(feature), key="1")
    known = datetime.now(UTC)
    late = samples.changed("confirmed", feature, samples.START_NS - samples.DAY_NS, observation_count=6)
    samples.commit(conn, late, key="2")
    start, instant = utc_from_ns(samples.START_NS), timedelta(microseconds=1)
    assert standing(conn) == [(2, start + instant, None)]
    assert standing(conn, valid_at=start) == [(1, start, start + instant)]
    assert standing(conn, known_at=known) == [(1, start, None)]


def test_system_time_never_runs_backwards(conn, samples):
    """The clock was a day ahead at the first commit, and was then corrected."""
    a, b = samples.feature("a"), samples.feature("b")
    ahead = datetime.now(UTC) + DAY
    with patch("conetl.db.map.commit.system_time", return_value=ahead):
        samples.commit(conn, samples.added(a), key="1")
    second = samples.commit(
        conn, samples.added(b), samples.changed("confirmed", a, samples.START_NS + 1, category="x"), key="2"
    )
    third = samples.commit(conn, samples.removed(b, samples.START_NS + samples.DAY_NS), key="3")
    times = [result.committed_at for result in (second, third)]
    assert times == [ahead + timedelta(microseconds=n) for n in (1, 2)]


def test_features_within_a_box(conn, samples):
    places = {"a": (0.0, 0.0, 1.0), "b": (10.0, 0.0, 1.0), "c": (0.0, 10.0, 1.0)}
    deltas = [samples.added(samples.feature(name, xyz_m=xyz)) for name, xyz in places.items()]
    samples.commit(conn, *deltas, key="1")
    found = store.read_features_as_of(conn, within=(-1, -1, 1, 20))
    assert {v.feature.xyz_m for v in found} == {places["a"], places["c"]}
    assert len(list(store.read_features_as_of(conn, within=(-1, -1, 1, 1)))) == 1


def test_maps_do_not_see_each_other(conn, samples):
    samples.commit(conn, samples.added(samples.feature("a")), key="1")
    samples.commit(conn, samples.added(samples.feature("b")), key="2", map_name="berlin", srid=32633)
    assert len(store.read_current_features(conn)) == len(store.read_current_features(conn, map_name="berlin")) == 1
    assert (store.find_map(conn).srid, store.find_map(conn, "berlin").srid) == (32632, 32633)
    assert store.find_changeset(conn, "1" * 64, map_name="berlin") is None
    # a feature of one map cannot be changed through another
    with pytest.raises(DatabaseError, match="feature_version_current"):
        samples.commit(conn, samples.removed(samples.feature("b"), samples.START_NS + 1), key="3")


def test_equal_coordinates_in_another_crs_disturb_no_drive(conn, samples):
    """The planner may compare geometries before it compares maps: with a thousand versions it does."""
    for key, srid in (("a", 32632), ("b", 32631)):
        samples.commit(conn, samples.added(samples.feature(key)), key=key, map_name=f"zone_{srid}", srid=srid)
    with conn.cursor() as cursor:
        cursor.execute("select drive_uuid from conetl.drive")
        drives = [row[0] for row in cursor.fetchall()]
        for kind in ("hashjoin", "mergejoin", "seqscan", "bitmapscan"):
            cursor.execute(f"set local enable_{kind} = off")
    for drive_uuid in drives:
        assert len(replay_store.read_standing_around(conn, drive_uuid)) == 1
        assert len(replay_store.read_versions(conn, [drive_uuid])[0]) == 1
        assert not replay_store.read_misses(conn, [drive_uuid], without=())


@pytest.mark.parametrize("stored", [60, 30])
@pytest.mark.parametrize(
    ("step_m", "of_every", "found"),
    [(1.0, 100, True), (1.0, 4, True), (1.3, 100, False)],
    ids=("a part", "frames lost", "another speed"),
)
def test_drives_along_one_street_at_another_speed_are_no_candidates(conn, samples, stored, step_m, of_every, found):
    """Hundreds of drives follow a street: reading all their frame pairs would take a minute."""
    days_ns = 3 * 86_400_000_000_000
    street = make_path(90, step_m)
    before = samples.drive("before").model_copy(
        update={"frame_pairs": tuple(make_path(90)[25 : 25 + stored]), "expected_frame_count": stored}
    )
    with store.map_transaction(conn):
        commit_changeset(conn, DriveRecords(before), samples.changeset(drive_id="before", key="1"))
    pairs = tuple(
        pair.model_copy(update={"captured_at_ns": pair.captured_at_ns + days_ns})
        for k, pair in enumerate(street[20:60])
        if k % of_every != 3
    )
    drive = samples.drive("now").model_copy(update={"frame_pairs": pairs, "expected_frame_count": 40})
    candidates = drives_at_the_same_time(conn, drive, path_wkt(drive), 2_000_000, map_name="default")
    assert [one.drive_id for one in candidates] == ["before"] * found


def test_another_crs_is_refused(conn, samples):
    samples.commit(conn, samples.added(samples.feature()), key="1")
    with pytest.raises(MapMismatchError, match=r"EPSG:32633.*EPSG:32632.*drive\.yaml"), store.map_transaction(conn):
        commit_changeset(conn, DriveRecords(samples.drive("b", srid=32633)), samples.changeset(drive_id="b", key="2"))
    assert len(store.list_changesets(conn)) == 1


def test_a_stale_reading_of_the_map_is_refused(conn, samples):
    feature = samples.feature()
    drive_uuid = samples.commit(conn, samples.added(feature), key="1").drive_uuid
    standing = replay_store.read_standing_around(conn, drive_uuid)
    newer = samples.changed("confirmed", feature, samples.START_NS + 1, observation_count=9)
    samples.commit(conn, newer, key="2")
    late = samples.changeset(samples.removed(feature, samples.START_NS + samples.DAY_NS), key="3")
    update = MapUpdate([*late.deltas], samples.update_of(late, standing).versions)
    with pytest.raises(MapMismatchError, match="map default changed since"), store.map_transaction(conn):
        replay_store.write_replay(
            conn, store.find_map(conn), replay_of_newest(standing, update, late.changeset_id), datetime.now(UTC)
        )
    assert store.read_current_features(conn) == [newer.new]


UNFIT = (
    ({"detections": lambda s: s.detections(frames=4)}, "detection of frame 3"),
    ({"positions": lambda s: s.positions(frames=2)}, r"track 0 with the unknown position \(2, 0\)"),
    ({"matches": lambda s: s.matches(frames=2)}, r"position \(2, 0\) without its stereo match"),
    ({"detections": lambda s: s.detections()[:-1]}, "stereo match 0 of frame 2 without its detections"),
    ({"tracks": lambda s: [s.track(track_index=5)]}, "with the unknown track 0"),
    ({"changeset": lambda s: s.changeset(drive_id="other")}, "a changeset of drive other"),
    ({"changeset": lambda s: s.changeset(*[s.added(s.feature())] * 2)}, "2 deltas of feature"),
)


def test_records_that_do_not_fit_together_are_refused(conn, samples):
    for changes, words in UNFIT:
        values = {
            "drive": samples.drive(),
            "detections": samples.detections(),
            "matches": samples.matches(),
            "positions": samples.positions(),
            "tracks": [samples.track()],
            "changeset": samples.changeset(samples.added(samples.feature())),
        }
        values |= {name: make(samples) for name, make in changes.items()}
        with pytest.raises(MapMismatchError, match=words), store.map_transaction(conn):
            commit_changeset(conn, changeset=values.pop("changeset"), records=DriveRecords(**values))
        assert store.find_map(conn) is None
        conn.rollback()


def test_rejections_come_back_whatever_they_hold(conn, samples):
    payload = {
        "yaw": float("nan"),
        "up": float("inf"),
        "name": "a\x00b\udc80",
        "path": Path("x"),
        "rows": ((1, 2), None),
    }
    rejections = [
        Rejection(
            step="frames", reason=RejectionReason.POSE_INVALID, record="frame pair 4\x00", detail="näh", payload=payload
        ),
        Rejection(step="frames", reason=RejectionReason.POSE_INVALID, record="frame pair 5", detail="", payload={}),
        Rejection(step="tracks", reason=RejectionReason.NOT_ON_GROUND, record="track 1", detail="d", payload={"n": 1}),
    ]
    changeset = samples.changeset()
    with store.map_transaction(conn):
        commit_changeset(conn, DriveRecords(samples.drive(), rejections=rejections), changeset)
    sql = "select * from quarantine where changeset_id = %(changeset_id)s"
    rows = execute(conn, sql, {"changeset_id": changeset.changeset_id})
    read = {row["record"]: row for row in rows}
    assert set(read) == {"frame pair 4\ufffd", "frame pair 5", "track 1"}
    assert read["frame pair 4\ufffd"]["detail"] == "näh"
    assert read["frame pair 4\ufffd"]["payload"] == {
        "yaw": "nan",
        "up": "inf",
        "name": "a\ufffdb\ufffd",
        "path": "x",
        "rows": [[1, 2], None],
    }
    reasons = Counter((row["step"], row["reason"]) for row in rows)
    assert reasons == {("frames", "pose_invalid"): 2, ("tracks", "not_on_ground"): 1}


def test_the_run_is_kept_with_its_parameters(conn, samples):
    run = RunInfo(uuid4(), datetime.now(UTC), {"track": {"gate_chi2": 16.0}}, flow_run_id="brave-newt")
    samples.commit(conn, key="1", run=run)
    [kept] = execute(conn, "select r.* from run r join changeset using (run_id)")
    assert (kept["run_id"], kept["params"], kept["flow_run_id"]) == (run.run_id, dict(run.params), "brave-newt")
    assert kept["started_at"] <= kept["finished_at"]


def test_an_instant_without_a_zone_is_refused(conn):
    with pytest.raises(ValueError, match="no time zone"):
        list(store.read_features_as_of(conn, datetime(2026, 1, 1)))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("1536", ["number"]),
        ("1537", []),  # the number of a changeset of another map, and how an id of this one begins
        ("153700", []),
        ("15370000", ["id"]),
        ("1538", []),
        ("15380000", ["number of 8 digits"]),
        ("15380000-", ["id of a number"]),
        ("15a0", ["letters"]),
        ("15a", []),
    ],
)
def test_digits_are_a_number_before_they_are_the_beginning_of_an_id(numbered, text, found):
    conn, ids = numbered
    names = {changeset_id: name for name, changeset_id in ids.items()}
    assert [names[one.id] for one in find_decisions(conn, text)] == found


@pytest.fixture(scope="module")
def numbered(module_conn, samples):
    """Changesets whose ids and numbers look alike, set by hand; 1537 is of another map."""
    conn, ids = module_conn, {}
    for key, (name, changeset_id, number, map_name) in enumerate(
        (
            ("number", "a0000000", 1536, "default"),
            ("also 1536", "15360000", 10, "default"),
            ("elsewhere", "b0000000", 1537, "other"),
            ("id", "15370000", 11, "default"),
            ("number of 8 digits", "c0000000", 15380000, "default"),
            ("id of a number", "15380000", 12, "default"),
            ("letters", "15a00000", 13, "default"),
        ),
        start=1,
    ):
        ids[name] = UUID(f"{changeset_id}-0000-4000-8000-000000000000")
        drive = samples.drive(f"drive_{key}", content_sha256=f"{key:064x}")
        changeset = samples.changeset(drive_id=drive.drive_id, key=f"{key:x}")
        with store.map_transaction(conn, map_name):
            commit_changeset(
                conn, DriveRecords(drive, [], [], [], []), changeset.model_copy(update={"changeset_id": ids[name]}),
                map_name=map_name,
            )  # fmt: skip
            renumber = "update conetl.changeset set changeset_no = %(number)s where changeset_id = %(id)s"
            execute(conn, renumber, {"number": number, "id": ids[name]})
    return conn, ids
