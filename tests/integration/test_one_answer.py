"""Every face of the map gives one answer: states and changes at random instants, now and then, after random histories.

`HISTORIES=500 pytest tests/integration/test_one_answer.py` plays more of them.
"""

from __future__ import annotations

import csv
import json
import os
from datetime import datetime, timedelta
from functools import cache
from itertools import count

import numpy as np
import pyarrow.parquet as pq
import shapely
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pyogrio import list_layers, read_dataframe

from conetl.db.connection import execute
from conetl.db.map.map_store import list_changesets, read_changes, read_features_as_of
from conetl.db.map.results import MapInstant
from conetl.exports import qgis_project
from conetl.exports.export import export_map
from conetl.exports.source import ExportContent, ExportRequest
from conetl.model.base import utc_from_ns
from conetl.model.errors import ConflictError, InputError
from conetl.pipeline.maps.decisions import accept_drive, decide_location, revert
from tests.integration import drives_of_days as world
from tests.integration.map_by_tables import Instant, MapByTables
from tests.synthetic.painted_road import Paint, markings_of
from tests.synthetic.road import random_world
from tests.synthetic.world import ORIGIN_M, START_NS, Cone
from tests.view_map import shown

HISTORIES = int(os.environ.get("HISTORIES", "1"))
WORLDS, WORLD_M, DAYS, DRIVES = 10, 45.0, 6, 4
HOUR_NS = 3_600_000_000_000
SECOND = timedelta(seconds=1)
_names = count()


@cache
def surveys(seed):
    """Drives over one random road, with lane markings in some, by the time of their recording."""
    rng = np.random.default_rng(seed)
    cones = random_world(rng, WORLD_M, DAYS)
    made = []
    for number, hour in enumerate(np.sort(rng.choice(24 * DAYS, DRIVES, replace=False)).tolist()):
        first_ns = START_NS + hour * HOUR_NS
        stands = [Cone((*xy, 0.0), height_m=cone.height_m) for cone in cones if (xy := cone.at(first_ns)) is not None]
        frames = int(rng.choice([12, 18]))
        one = world.survey_of(stands, rng, f"{seed} {number}", frames=frames, start_m=0.0, first_ns=first_ns)
        if seed % 2:
            asides_m = rng.choice([4.5, 1.5, -2.0, -5.0], 2, replace=False)
            first, last = (
                pair.pose.map_t_body_m[0] - ORIGIN_M[0]
                for pair in (one.drive.frame_pairs[0], one.drive.frame_pairs[-1])
            )
            offset_m = np.subtract(
                one.drive.frame_pairs[0].pose.map_t_body_m, (ORIGIN_M[0] + round(first), *ORIGIN_M[1:])
            )
            seen = markings_of(
                [Paint(aside) for aside in asides_m], rng, (first + 5.0, last + 10.0), offset_m=offset_m, offset_sigma_m=0.3,
                seen_ns=one.drive.frame_pairs[0].captured_at_ns,
            )  # fmt: skip
            one = one._replace(markings=seen)
        made.append(one)
    return made


def play(conn, seed, map_name):
    """Drives in a random order, and decisions of people between them. Returns instants of the database between the steps."""
    rng = np.random.default_rng(seed)
    pool = surveys(int(rng.integers(WORLDS)))
    moments = []
    for number in rng.permutation(len(pool))[: int(rng.integers(2, DRIVES + 1))].tolist():
        world.merge(conn, pool[number], map_name=map_name)
        if rng.random() < 0.6:
            decide(conn, rng, map_name)
        moments.append(execute(conn, "select clock_timestamp() as now")[0]["now"])
        conn.rollback()
    return moments


_DECISIONS = (
    "select d.decision_id::text as id from active_decision d join map m using (map_id) where m.map_name = %(m)s"
)


def decide(conn, rng, map_name):
    standing = [one.feature for one in read_features_as_of(conn, map_name=map_name, lines=True)]
    drives = list_changesets(conn, map_name=map_name)
    decisions = execute(
        conn,
        "select d.decision_id::text as id from active_decision d join map m using (map_id) where m.map_name = %(m)s",
        {"m": map_name},
    )
    kind = rng.choice(["suppress", "pin", "classify", "revert", "withdraw", "accept"])
    try:
        if kind in ("suppress", "pin", "classify") and standing:
            category = {"category": "drum"} if kind == "classify" else {}
            decide_location(
                conn, kind, str(standing[rng.integers(len(standing))].feature_id), map_name=map_name, **category
            )
        elif kind == "revert":
            revert(conn, str(drives[rng.integers(len(drives))].changeset_no), map_name=map_name)
        elif kind == "withdraw" and decisions:
            revert(conn, decisions[rng.integers(len(decisions))]["id"], map_name=map_name)
        elif kind == "accept":
            accept_drive(conn, str(drives[rng.integers(len(drives))].changeset_no), map_name=map_name)
    except (ConflictError, InputError):
        conn.rollback()


def drawn(rng, tables, moments):
    """An instant: of the road before, at and after what happened, or the latest; of the database between two steps, or now."""
    happened = [row["valid_from"] for rows in tables.versions.values() for row in rows]
    valid = None
    if rng.random() < 0.8:
        valid = happened[rng.integers(len(happened))] + timedelta(microseconds=int(rng.integers(-1, 2))) * int(
            rng.choice([1, 10**6])
        )
    return Instant(valid, moments[rng.integers(len(moments))] if rng.random() < 0.6 else None)


def values_of(one):
    """What is compared of a state of `MapByTables`."""
    return {
        "version": one.version, "category": one.category, "existence_probability": one.existence, "seen_count": one.seen,
        "missed_count": one.missed, "observation_count": one.observations, "object_height_m": one.height_m,
        "first_seen_at": utc_from_ns(one.first_seen_ns), "last_seen_at": utc_from_ns(one.last_seen_ns),
        "valid_from": one.valid_from, "valid_to": one.valid_to, "changeset_id": one.changeset,
        "sigma_e_m": one.cov_m2[0] ** 0.5, "sigma_n_m": one.cov_m2[3] ** 0.5, "sigma_u_m": one.cov_m2[5] ** 0.5,
        "cov_en_m2": one.cov_m2[1], "cov_eu_m2": one.cov_m2[2], "cov_nu_m2": one.cov_m2[4],
        "easting_m": one.xyz_m[0], "northing_m": one.xyz_m[1], "ellipsoidal_height_m": one.xyz_m[2],
    }  # fmt: skip


def assert_same(face, found, expected, where, *, places=1e-9, whole_seconds=False, without=()):
    """found, expected: values by id. A face may leave out values, or round them."""
    assert found.keys() == expected.keys(), f"{face} at {where}: {found.keys() ^ expected.keys()}"
    for key, own in found.items():
        for name, wanted in expected[key].items():
            if name not in own or name in without:
                continue
            value, due = own[name], wanted
            if isinstance(wanted, datetime) and isinstance(value, str):
                value = datetime.fromisoformat(value)
            if isinstance(wanted, datetime) and whole_seconds:
                value, due = value.replace(microsecond=0), wanted.replace(microsecond=0)
            if isinstance(due, float):
                near = places * max(1.0, 0.0 if places > 1e-6 else abs(due))
                same = value is not None and abs(value - due) <= near
            else:
                same = value == due
            assert same, f"{face} at {where}: {name} of {key} is {own[name]!r}, expected {wanted!r}"


class Faces:
    """The ways to ask for one map."""

    def __init__(self, conn, conetl, client, map_name, folder):
        self.conn, self.conetl, self.client, self.map_name, self.folder = conn, conetl, client, map_name, folder

    def assert_states(self, at, expected):
        values = {key: values_of(one) for key, one in expected.items()}
        points = {key: one for key, one in values.items() if expected[key].line_m is None}
        lines = {key: one for key, one in values.items() if key not in points}
        stored = {
            str(one.feature.feature_id): one
            for one in read_features_as_of(self.conn, at.valid, known_at=at.known, map_name=self.map_name, lines=True)
        }
        self.conn.rollback()
        assert stored.keys() == values.keys()
        for key, one in stored.items():
            feature, wanted = one.feature, expected[key]
            assert (feature.xyz_m, feature.cov_m2, feature.existence_probability) == (
                wanted.xyz_m,
                wanted.cov_m2,
                wanted.existence,
            )
            assert (feature.seen_count, feature.missed_count, feature.version) == (
                wanted.seen,
                wanted.missed,
                wanted.version,
            )
            assert (one.valid_from, one.valid_to, str(one.changeset_id)) == (
                wanted.valid_from,
                wanted.valid_to,
                wanted.changeset,
            )
        options = [
            f"--{name}={instant.isoformat()}"
            for name, instant in (("as-of", at.valid), ("known-at", at.known))
            if instant
        ]
        listed = json.loads(self.conetl("map", "show", "--json", "--map", self.map_name, *options))["features"]
        assert_same("map show", {one["feature_id"]: one for one in listed}, values, at)
        self._assert_files(ExportRequest(self.map_name, as_of=at.valid, known_at=at.known), points, lines, at)
        asked = {name: instant.isoformat() for name, instant in (("at", at.valid), ("known_at", at.known)) if instant}
        for kind, wanted in (("features", points), ("lane_markings", lines)):
            items = self.client.get(
                f"/ogc/collections/{self.map_name}.{kind}/items", params={"limit": 1000, **asked}
            ).json()
            assert_same(f"OGC {kind}", {i["id"]: i["properties"] for i in items["features"]}, wanted, at)
            assert items["numberMatched"] == len(wanted)
        asked = {
            name: instant.isoformat() for name, instant in (("valid_at", at.valid), ("known_at", at.known)) if instant
        }
        answer = shown(self.client, self.map_name, **asked)
        page = {one["feature_id"]: self._on_page(one, answer) for one in (*answer["features"], *answer["markings"])}
        assert_same("page", page, values, at, places=1e-4)
        if at == Instant():
            for geometry, wanted in (({}, points), ({"lines": True}, lines)):
                rows = execute(self.conn, qgis_project._statement("qgis_now", geometry), {"map_name": self.map_name})
                self.conn.rollback()
                assert_same("QGIS", {row["feature_id"]: row for row in rows}, wanted, at, without=("changeset_id",))

    def _assert_files(self, request, points, lines, where):
        for form, places in (("geojson", 1e-4), ("csv", 1e-4), ("geoparquet", 1e-9), ("gpkg", 1e-9)):
            path = self.folder / f"map.{form}"
            export_map(self.conn, path, form, request)
            one_file = form in ("geojson", "gpkg")
            for layer, wanted in enumerate((points, lines)):
                file = path if one_file or not layer else path.with_name(f"map_lane_markings.{form}")
                rows = _READERS[form](file, layer) if file.exists() else {}
                if form == "geojson":
                    rows = {key: row for key, row in rows.items() if ("width_m" in row) == bool(layer)}
                cut = form == "gpkg"
                assert_same(f"{form} of {request.what}", rows, wanted, where, places=places, whole_seconds=cut)
            for file in self.folder.glob("map*"):
                file.unlink()

    def _on_page(self, one, answer):
        x, y, z = (value + origin for value, origin in zip(one["xyz_m"], answer["origin_m"], strict=True))
        return one | {"easting_m": x, "northing_m": y, "ellipsoidal_height_m": z}

    def assert_changes(self, begin, end, tables):
        expected = tables.changes(begin, end)
        wanted = {
            key: {"change": kind, "shift_m": shift_m} | values_of(new or tables.gone(key, end) or old)
            for key, (kind, shift_m, old, new) in expected.items()
        }
        for key, (_, _, old, _) in expected.items():
            if old is not None:
                names = ("old_version", "old_easting_m", "old_northing_m", "old_ellipsoidal_height_m")
                wanted[key] |= dict(zip(names, (old.version, *old.xyz_m), strict=True))
        is_line = {key: (new or old).line_m is not None for key, (_, _, old, new) in expected.items()}
        where, without = (begin, end), ("valid_to", "valid_from", "changeset_id")
        found = read_changes(self.conn, MapInstant(*begin), MapInstant(*end), map_name=self.map_name)
        self.conn.rollback()
        assert_same(
            "store",
            {str(c.feature_id): {"change": c.kind.value, "shift_m": c.shift_m} for c in found},
            wanted,
            where,
            places=1e-7,
        )
        for change in found:
            _, _, old, new = expected[str(change.feature_id)]
            assert [one and (one.xyz_m, one.existence_probability) for one in (change.old, change.new)] == [
                one and (one.xyz_m, one.existence) for one in (old, new)
            ]
        if begin.valid and end.valid and begin.valid <= end.valid and begin.known == end.known:
            known = [f"--known-at={end.known.isoformat()}"] if end.known else []
            said = self.conetl(
                "map", "diff", begin.valid.isoformat(), end.valid.isoformat(), "--json", "--map", self.map_name, *known
            )
            said = {c["feature_id"]: c | {"change": c["kind"]} for c in json.loads(said)}
            bare = {key: {name: one[name] for name in ("change", "shift_m")} for key, one in wanted.items()}
            assert_same("map diff", said, bare, where, places=1e-7)
            request = ExportRequest(
                self.map_name, ExportContent.CHANGES, since=begin.valid, until=end.valid, known_at=end.known
            )
            both = [
                {
                    key: {n: v for n, v in one.items() if n not in without}
                    for key, one in wanted.items()
                    if is_line[key] is of
                }
                for of in (False, True)
            ]
            self._assert_files(request, *both, where)
        instants = {
            "from_valid_at": begin.valid,
            "from_known_at": begin.known,
            "to_valid_at": end.valid,
            "to_known_at": end.known,
        }
        asked = {name: instant.isoformat() for name, instant in instants.items() if instant}
        answer = self.client.get(f"/api/maps/{self.map_name}/changes/view", params=asked).json()
        page = {
            c["feature_id"]: self._on_page(c, answer) | {"change": c["kind"]}
            for c in (*answer["changes"], *answer["markings"])
        }
        assert_same("page", page, wanted, where, places=1e-4)
        if begin.valid and (end.valid is None or begin.valid <= end.valid) and (end.known or begin.known is None):
            instants = {"from": begin.valid, "known_from": begin.known, "to": end.valid, "known_to": end.known}
            asked = {name: instant.isoformat() for name, instant in instants.items() if instant}
            items = self.client.get(
                f"/ogc/collections/{self.map_name}.changes/items", params={"limit": 1000, **asked}
            ).json()
            points = {key: one for key, one in wanted.items() if not is_line[key]}
            if begin.known or end.known is None:
                assert_same(
                    "OGC changes",
                    {i["id"]: i["properties"] for i in items["features"]},
                    points,
                    where,
                    places=1e-7,
                    without=without,
                )

    def assert_histories(self, expected):
        """The history of single features ends with the state that stands."""
        for key in sorted(expected)[:2]:
            one = expected[key]
            log = json.loads(self.conetl("map", "log", key, "--json", "--map", self.map_name))
            last = [entry for entry in log if entry["known_to"] is None][-1]
            assert (last["existence_probability"], last["observation_count"]) == (one.existence, one.observations)
            history = self.client.get(f"/api/maps/{self.map_name}/features/{key}").json()["history"]
            assert [history[-1][name] for name in ("existence_probability", "seen_count", "missed_count")] == [
                one.existence, one.seen, one.missed,
            ]  # fmt: skip


def _geojson(file, layer):
    return {one["properties"]["feature_id"]: one["properties"] for one in json.loads(file.read_text())["features"]}


def _csv(file, layer):
    numbers = ("_m", "_m2", "probability")
    found = {}
    with file.open() as lines:
        for row in csv.DictReader(lines):
            given = {name: value for name, value in row.items() if value != ""}
            typed = {name: float(value) for name, value in given.items() if name.endswith(numbers)}
            typed |= {name: int(value) for name, value in given.items() if name.endswith(("count", "version"))}
            found[row["feature_id"]] = dict.fromkeys(row) | given | typed
    return found


def _parquet(file, layer):
    found = {}
    for row in pq.read_table(file).to_pylist():
        place = shapely.from_wkb(row["geometry"])
        if place.geom_type == "Point":
            row |= {"easting_m": place.x, "northing_m": place.y, "ellipsoidal_height_m": place.z}
        found[row["feature_id"]] = row
    return found


def _gpkg(file, layer):
    layers = list_layers(file)[:, 0].tolist()
    if layer >= len(layers):
        return {}
    rows = read_dataframe(file, layer=layers[layer], read_geometry=False)
    rows = rows.astype(object).where(rows.notna(), None)
    return {
        row["feature_id"]: {
            name: value.to_pydatetime() if hasattr(value, "to_pydatetime") else value for name, value in row.items()
        }
        for row in rows.to_dict("records")
    }


_READERS = {"geojson": _geojson, "csv": _csv, "geoparquet": _parquet, "gpkg": _gpkg}


@settings(
    max_examples=HISTORIES,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # shrinking would take minutes
)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_face_gives_one_answer(conn, conetl, own_view, tmp_path, seed):
    map_name = f"map{next(_names)}"
    rng = np.random.default_rng(seed)
    moments = play(conn, seed, map_name)
    play(conn, seed + 1, f"{map_name}-other")  # another map of the same database
    tables, faces = MapByTables(conn, map_name), Faces(conn, conetl, own_view, map_name, tmp_path)
    if not tables.versions:
        return  # all its drives are on hold
    now = tables.standing(Instant())
    faces.assert_states(Instant(), now)
    faces.assert_histories(now)
    for _ in range(3):
        at = drawn(rng, tables, moments)
        faces.assert_states(at, tables.standing(at))
        begin, end = drawn(rng, tables, moments), drawn(rng, tables, moments)
        if rng.random() < 0.5:
            end = end._replace(known=begin.known)
        if begin.valid and end.valid and begin.valid > end.valid:
            begin, end = begin._replace(valid=end.valid), end._replace(valid=begin.valid)
        faces.assert_changes(begin, end, tables)
    assert world.failed_audits(conn) == []
