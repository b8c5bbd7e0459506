"""A map of others as a beginning: whole and right, or refused by row with nothing written."""

from __future__ import annotations

import csv
import json
import math
import re
import struct
from datetime import UTC, datetime, timedelta
from uuid import UUID

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pytest
import shapely
from pyproj import Transformer

from conetl.db.connection import execute
from conetl.db.map.map_store import list_changesets, read_current_features, read_features_as_of
from conetl.db.receipt_store import pending_changesets
from conetl.exports import FORMATS
from conetl.exports.export import export_map
from conetl.exports.source import ExportContent, ExportRequest
from conetl.files.documents import MAX_TEXT_BYTES
from conetl.files.parquet_store import file_sha256
from conetl.model.base import ns_from_utc, utc_from_ns
from conetl.model.errors import InputError
from conetl.model.map_records import DeltaKind
from conetl.model.params import ImportParams
from conetl.pipeline.maps.decisions import revert
from conetl.pipeline.maps.import_map import import_map
from conetl.readers.base_layers.line_files import read_vector_file
from conetl.readers.maps.imported_rows import read_map_file
from conetl.readers.surveyed_points import read_surveyed_points
from tests.integration.drives_of_days import DAY_NS, DAYS, START_NS, failed_audits, merge, survey, valid_time_map
from tests.synthetic.world import ORIGIN_M
from tests.view_map import shown

IMPORTABLE = [name for name in FORMATS if name not in ("mcap", "lanelet2")]
PARAMS = ImportParams()
NEW_IDS = ImportParams(new_ids=True)
SURVEYED = {"stated_at": datetime(2026, 3, 1, tzinfo=UTC)}
IN_UTM = SURVEYED | {"crs": "EPSG:32632"}


def read(path, *, params=PARAMS, map_srid=32632, **options):
    return read_map_file(path, params, map_srid=map_srid, **options)


def take(conn, path, *, params=PARAMS, map_name="default", accept=False, **options):
    return import_map(conn, read(path, params=params, **options), params, map_name=map_name, accept=accept)


def complaint(path, message, **options):
    with pytest.raises(InputError, match=message):
        read(path, **options)


@pytest.fixture(scope="module")
def surveyed(another_database, tmp_path_factory):
    """Files of a map of two drives, one a format, and its features."""
    folder = tmp_path_factory.mktemp("exports")
    with another_database() as conn:
        for day in range(2):
            merge(conn, survey(day))
        for name in IMPORTABLE:
            export_map(conn, folder / f"map{FORMATS[name].suffix}", name, ExportRequest())
        return folder, read_current_features(conn)


@pytest.mark.parametrize("name", IMPORTABLE)
def test_an_exported_map_comes_back(conn, surveyed, name):
    folder, features = surveyed
    done = take(conn, folder / f"map{FORMATS[name].suffix}")
    assert (done.committed, done.counts[DeltaKind.ADDED], done.replayed) == (True, len(features), 0)
    back = read_current_features(conn)
    assert [f.feature_id for f in back] == [f.feature_id for f in features]
    for one, other in zip(back, features, strict=True):
        assert one.xyz_m == pytest.approx(other.xyz_m, abs=0.001)
        assert np.sqrt([one.cov_m2[i] for i in (0, 3, 5)]) == pytest.approx(
            np.sqrt([other.cov_m2[i] for i in (0, 3, 5)]), abs=1e-4
        )
        assert one.existence_probability == pytest.approx(other.existence_probability, abs=1e-6)
        assert (one.object_height_m, one.observation_count) == (
            pytest.approx(other.object_height_m, abs=1e-4),
            other.observation_count,
        )
        assert one.object_height_sigma_m == pytest.approx(other.object_height_sigma_m, abs=1e-4)
        assert abs(one.last_seen_ns - other.last_seen_ns) < 1000
        if name not in ("geojson", "csv"):  # which round
            assert one.cov_m2 == pytest.approx(other.cov_m2, rel=1e-12)
    assert failed_audits(conn) == []
    assert not take(conn, folder / f"map{FORMATS[name].suffix}").committed
    assert len(list_changesets(conn)) == 1


@pytest.mark.parametrize("name", IMPORTABLE)
def test_small_correlated_covariances_come_back(conn, samples, tmp_path, name):
    cov_m2 = (8.1e-5, 7.3e-5, 0.0, 8.1e-5, 0.0, 4e-4)
    samples.commit(conn, samples.added(samples.feature(cov_m2=cov_m2)), key="1")
    path = tmp_path / f"map{FORMATS[name].suffix}"
    export_map(conn, path, name, ExportRequest())
    [statement] = read(path).statements
    assert statement.feature.cov_m2 == pytest.approx(cov_m2, rel=0.02, abs=1e-8)


VALID_TIMES = """
select v.first_seen_ns, v.last_seen_ns, lower(v.valid_period) as valid_from
from conetl.feature_version v join conetl.map m using (map_id)
where m.map_name = %(map_name)s and upper_inf(v.system_period)
order by v.first_seen_ns
"""


def test_times_come_back_to_the_microsecond(conn, tmp_path):
    plan = tmp_path / "plan.csv"
    header = "easting_m,northing_m,ellipsoidal_height_m,valid_from,first_seen_at,last_seen_at"
    times = [",".join(f"2026-03-01T08:00:0{n}.{number}23457Z" for n in range(3)) for number in (1, 9)]
    plan.write_text("\n".join([header, f"458000,5428000,115,{times[0]}", f"458010,5428000,115,{times[1]}"]))
    take(conn, plan, crs="EPSG:32632")
    written = [tuple(row.values()) for row in execute(conn, VALID_TIMES, {"map_name": "default"})]
    conn.rollback()
    assert [seen_ns % 1_000_000_000 for seen_ns, *_ in written] == [123_457_000, 923_457_000]
    for name in IMPORTABLE:
        path = tmp_path / f"map{FORMATS[name].suffix}"
        export_map(conn, path, name, ExportRequest())
        take(conn, path, map_name=name, params=NEW_IDS)
        assert [tuple(row.values()) for row in execute(conn, VALID_TIMES, {"map_name": name})] == written, name
        conn.rollback()


@pytest.mark.parametrize("text", ["2026/03/01 08:00:00.123456", "2026-03-01T09:00:00.1234567+01:00"])
def test_times_of_geojson_are_read_as_they_are_written(tmp_path, text):
    found = read(geojson(tmp_path / "a.geojson", [(GOOD[0], {"last_seen_at": text})]))
    assert found.stated_at_ns == 1_772_352_000_123_456_000


def features_one_after_the_other(path, rows, *, mark="", indent=None):
    path.write_text("".join(f"{mark}{json.dumps(feature, indent=indent)}\n" for feature in point_features(rows)))
    return path


@pytest.mark.parametrize(("mark", "indent"), [("", None), ("\x1e", 1)])
def test_a_sequence_of_features_says_what_the_collection_says(tmp_path, mark, indent):
    """One feature a line, or RFC 8142; times to the microsecond, which GDAL cuts to milliseconds there."""
    rows = [
        (GOOD[0], {"last_seen_at": "2026-03-01T08:00:00.123456Z", "category": "cone ä"}),
        (OTHER, {"last_seen_at": "2026-03-01T08:00:00.1Z"}),
    ]
    path = features_one_after_the_other(tmp_path / "sequence.geojson", rows, mark=mark, indent=indent)
    found = read(path)
    assert (found.stated_at_ns, found.name) == (1_772_352_000_123_456_000, path.name)
    collection = read(geojson(tmp_path / "collection.geojson", rows))
    of_file = {"feature_id": UUID(int=0)}
    assert [s.feature.model_copy(update=of_file) for s in found.statements] == [
        s.feature.model_copy(update=of_file) for s in collection.statements
    ]


@pytest.mark.parametrize(
    ("row", "text", "message"),
    [
        (1, '{"type": "Feature", "geom', "row 2: this is not a GeoJSON feature"),
        (2, '{"type": "Feature", "geom', "row 3: this is not a GeoJSON feature"),
        (1, "3", "row 2: expected a GeoJSON Feature"),
        (1, "{}", "row 2: expected a GeoJSON Feature"),
    ],
)
def test_a_sequence_with_a_broken_row_is_refused_as_a_whole(tmp_path, row, text, message):
    """GDAL leaves such rows out and does not say so: a half-imported map."""
    rows = [([8.43 + i * 1e-4, 49.01, 115.0], SEEN) for i in range(3)]
    path = features_one_after_the_other(tmp_path / "cut.geojson", rows)
    lines = path.read_text().splitlines()
    lines[row] = text
    path.write_text("\n".join(lines))
    complaint(path, message)


def test_drives_confirm_move_and_remove_imported_cones(conn, tmp_path):
    """A cone list of the first day, the drive of the second: as if a drive had been there."""
    names = ["object_height_m", "sigma_e_m", "sigma_n_m", "sigma_u_m"]
    path = cones_csv(tmp_path / "plan.csv", DAYS[0], names, [[cone.height_m, 0.05, 0.05, 0.05] for cone in DAYS[0]])
    day = datetime.fromtimestamp(START_NS / 1e9, UTC)
    with pytest.raises(InputError, match="--surveyed-at"):
        take(conn, path, crs="EPSG:32632")
    take(conn, path, crs="EPSG:32632", stated_at=day)
    merged = merge(conn, survey(1))
    kinds = {kind: sum(d.kind is kind for d in merged.changeset.deltas) for kind in DeltaKind}
    assert kinds[DeltaKind.CONFIRMED] >= 4
    assert (kinds[DeltaKind.MOVED], kinds[DeltaKind.REMOVED], kinds[DeltaKind.ADDED]) == (1, 1, 0)
    assert failed_audits(conn) == []


def test_an_import_saw_no_cone(conn, surveyed):
    """`conetl map show` counts drives, as the web view, OGC API and exports do."""
    take(conn, surveyed[0] / "map.parquet")
    shown = list(read_features_as_of(conn))
    conn.rollback()
    assert {v.feature.seen_count for v in shown} == {0}
    merge(conn, survey(2))
    assert {feature.seen_count for feature in read_current_features(conn)} == {1}
    pending, drive = pending_changesets(conn, map_name="default", quiet=timedelta(0)), list_changesets(conn)[0]
    assert pending == [drive.changeset_id], "events are of drives alone"


@pytest.mark.parametrize("name", ["object_height", "height"])
def test_the_height_of_an_object_is_read_by_its_name_now_and_before_0_3(tmp_path, name):
    path = cones_csv(tmp_path / "plan.csv", DAYS[0][:1], [f"{name}_m", f"{name}_sigma_m"], [[0.63, 0.017]])
    [statement] = read(path, **IN_UTM).statements
    assert (statement.feature.object_height_m, statement.feature.object_height_sigma_m) == (0.63, 0.017)


def cones_csv(path, cones, names=(), values=None):
    """The cones' places, and further columns."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["easting_m", "northing_m", "ellipsoidal_height_m", *names])
        for cone, more in zip(cones, values or [[] for _ in cones], strict=True):
            writer.writerow([*(round(a + b, 4) for a, b in zip(ORIGIN_M, cone.foot_m, strict=True)), *more])
    return path


def test_an_import_has_its_place_in_time_whatever_comes_first(another_database, tmp_path):
    """Two drives and an import between them, which comes first, second or last: one map."""
    cones = [*DAYS[0][:5], *DAYS[2][-1:]]
    names = ["feature_id", "sigma_e_m", "sigma_n_m", "sigma_u_m"]
    values = [[f"00000000-0000-4000-8000-00000000000{number}", 0.3, 0.3, 0.1] for number in range(len(cones))]
    path = cones_csv(tmp_path / "between.csv", cones, names, values)
    stated_at = datetime.fromtimestamp((START_NS + DAY_NS // 2) / 1e9, UTC)
    events = {
        "a": lambda conn: merge(conn, survey(0)),
        "b": lambda conn: merge(conn, survey(1)),
        "import": lambda conn: take(conn, path, crs="EPSG:32632", stated_at=stated_at),
    }
    maps = []
    for order in (("import", "b", "a"), ("b", "import", "a"), ("a", "b", "import")):
        with another_database() as conn:
            for name in order:
                events[name](conn)
            assert failed_audits(conn) == []
            maps.append(valid_time_map(conn))
    assert maps[0]["versions"]
    assert all(found == maps[0] for found in maps)


def test_an_import_is_reverted_and_brought_back(conn, surveyed):
    folder, features = surveyed
    take(conn, folder / "map.parquet")
    before = valid_time_map(conn)
    decision = revert(conn, "1", map_name="default")
    assert read_current_features(conn) == []
    conn.rollback()
    revert(conn, str(decision.decision_id), map_name="default")
    assert valid_time_map(conn) == before
    assert len(read_current_features(conn)) == len(features)
    assert failed_audits(conn) == []


def test_ids_are_unique_in_a_database(conn, surveyed):
    folder, features = surveyed
    take(conn, folder / "map.parquet")
    with pytest.raises(InputError, match=r"row 1: feature .* belongs to the map default .*--new-ids"):
        take(conn, folder / "map.parquet", map_name="copy")
    assert take(conn, folder / "map.parquet", map_name="copy", params=ImportParams(new_ids=True)).committed
    assert len(read_current_features(conn, map_name="copy")) == len(features)


@pytest.mark.parametrize("name", ["map.parquet", "plain.csv"])
def test_a_file_whose_ids_are_founded_goes_onto_several_maps(conn, surveyed, tmp_path, name):
    """As onto one for tests and the one for production, with ids that are not wanted and without any."""
    folder, _ = surveyed
    path = folder / name if name == "map.parquet" else plain_csv(tmp_path)
    options = {} if name == "map.parquet" else IN_UTM
    ids = []
    for map_name in ("default", "test"):
        assert take(conn, path, map_name=map_name, params=NEW_IDS, **options).committed
        ids.append({feature.feature_id for feature in read_current_features(conn, map_name=map_name)})
        conn.rollback()
        assert not take(conn, path, map_name=map_name, params=NEW_IDS, **options).committed
    assert len(ids[0]) == len(ids[1]) > 0
    assert not ids[0] & ids[1]
    assert failed_audits(conn) == []


def plain_csv(folder):
    """Places only."""
    return cones_csv(folder / "plain.csv", DAYS[0])


def test_heights_of_another_system_are_refused_where_the_map_has_the_same_cones(conn, tmp_path):
    """Heights above the geoid put a second cone below each one of the map."""
    merge(conn, survey(0))
    before = valid_time_map(conn)
    conn.commit()
    path = tmp_path / "geoid.csv"
    lines = cones_csv(path, DAYS[0]).read_text().splitlines()
    rows = [line.rsplit(",", 1) for line in lines[1:]]
    path.write_text("\n".join([lines[0], *(f"{place},{float(height) - 47.6}" for place, height in rows)]))
    with pytest.raises(InputError, match=r"47\.6 m lower .*--crs EPSG:25832\+7837.* nothing was written"):
        take(conn, path, **IN_UTM)
    conn.rollback()
    assert valid_time_map(conn) == before
    conn.commit()
    assert take(conn, path, map_name="empty", **IN_UTM).committed
    assert take(conn, plain_csv(tmp_path), **IN_UTM).committed


def test_a_wrong_zone_is_refused_where_the_maps_own_would_put_the_file_on_the_map(conn, tmp_path):
    """Six degrees of longitude, 439 km: within the margin of the map's own area of use."""
    path = plain_csv(tmp_path)
    assert take(conn, path, map_name="empty", crs="EPSG:32633", **SURVEYED).far == 0, "nothing to compare it with"
    merge(conn, survey(0))
    conn.commit()
    with pytest.raises(InputError, match=r"1 km from everything .*--crs EPSG:32632\).*--accept.* nothing was written"):
        take(conn, path, crs="EPSG:32633", **SURVEYED)
    conn.rollback()
    assert take(conn, path, **IN_UTM).far == 0
    path.write_text(path.read_text() + "\n")  # another file: the ids of this one are on the map
    accepted = take(conn, path, crs="EPSG:32633", accept=True, **SURVEYED)
    assert (accepted.counts[DeltaKind.ADDED], accepted.far) == (len(DAYS[0]), len(DAYS[0]))
    assert failed_audits(conn) == []


def test_cones_of_another_datum_are_refused_unless_they_are_accepted(conn, tmp_path):
    irregular = [(0.0, 0.0), (5.3, 0.2), (9.4, 0.1), (14.8, 0.4), (19.1, 0.2)]

    def survey_file(name, east_m, north_m):
        rows = [f"{458000 + x + east_m},{5428000 + y + north_m},115" for x, y in irregular]
        (tmp_path / name).write_text("\n".join(["easting_m,northing_m,ellipsoidal_height_m", *rows]))
        return tmp_path / name

    assert take(conn, survey_file("etrs.csv", 0.0, 0.0), **IN_UTM).committed
    other = survey_file("ed50.csv", 81.0, 202.0)
    with pytest.raises(InputError, match=r"are 217\.6 m from those of the map default.*--accept.* nothing was written"):
        take(conn, other, **IN_UTM)
    conn.rollback()
    assert take(conn, other, accept=True, **IN_UTM).counts[DeltaKind.ADDED] == len(irregular)


@pytest.mark.parametrize(("decimals", "sigma_m", "refused"), [(5, 0.02, True), (5, 0.4, False), (7, 0.02, False)])
def test_rounded_degrees_are_refused_where_the_stated_sigmas_do_not_cover_it(tmp_path, decimals, sigma_m, refused):
    rows = [
        ([round(8.43 + 1.2345678e-5 * k, decimals), round(49.01 + 1e-5 * k, decimals), 115.0], SEEN) for k in range(5)
    ]
    path, params = geojson(tmp_path / "a.geojson", rows), ImportParams(sigma_m=sigma_m)
    if refused:
        message = r"rounded to 1\.1 m, but the stated sigmas are 0\.02 m.* cover the rounding \(0\.34 m\); nothing was written"
        complaint(path, message, params=params)
    else:
        assert len(read(path, params=params).statements) == 5


@pytest.mark.parametrize(
    ("writing", "sigma_m", "message"),
    [
        (lambda x: f"{x:.0f}", 0.02, "rounded to 1 m, but the stated sigmas are 0.02 m"),
        (lambda x: f"{x:.1f}", 0.02, "rounded to 0.1 m"),
        (lambda x: f"{float(np.float32(x)):.4f}", 0.02, "rounded to 0.5 m"),  # as three.js and PLY files hold them
        (lambda x: str(np.float32(x)), 0.02, "rounded to 0.5 m"),
        (lambda x: f"{x:.3f}", 0.02**2, r"0\.0004 m \(median\).* a variance"),
        (lambda x: f"{x:.2f}", 0.02, None),
        (lambda x: f"{x:.0f}", 0.3, None),
    ],
)  # fmt: skip
def test_files_that_know_less_than_their_sigmas_state_are_refused(tmp_path, writing, sigma_m, message):
    """Maps, control points and check points."""
    random = np.random.default_rng(1)
    places = random.uniform((458300, 5427850), (458360, 5427910), (9, 2))
    rows = [f"{writing(x)},{writing(y)},{115 + number / 7}" for number, (x, y) in enumerate(places)]
    path = tmp_path / "places.csv"
    path.write_text("\n".join(["easting,northing,ellipsoidal_height_m", *rows]))
    readers = (
        lambda: read(path, params=ImportParams(sigma_m=sigma_m), **IN_UTM),
        lambda: read_surveyed_points(path, 32632, crs="EPSG:32632", sigma_m=sigma_m),
    )
    for reader in readers:
        if message is None:
            reader()
        else:
            with pytest.raises(InputError, match=message):
                reader()


def test_rounded_heights_are_refused(tmp_path):
    path = tmp_path / "hill.csv"
    rows = [f"{458300 + 5.01234 * k},5427850.12,{round(115 + k**1.5)}" for k in range(6)]
    path.write_text("\n".join(["easting,northing,ellipsoidal_height_m", *rows]))
    complaint(path, "rounded to 1 m, but the stated sigmas are 0.1 m", params=ImportParams(sigma_m=0.1), **IN_UTM)
    assert len(read(path, params=ImportParams(sigma_m=0.3), **IN_UTM).statements) == 6


def test_a_few_planned_places_may_be_round_numbers(tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text("\n".join(["easting,northing,height_m", *(f"{458300 + 5 * k},5427850,115" for k in range(9))]))
    assert len(read_surveyed_points(path, 32632, crs="EPSG:32632", sigma_m=0.02)) == 9


def test_the_same_file_by_its_right_crs_is_another_import(conn, tmp_path):
    """A slip in --crs is corrected by reverting and importing again, with no other option changed."""
    path = plain_csv(tmp_path)
    take(conn, path, crs="EPSG:32633", **SURVEYED)
    with pytest.raises(InputError, match=r"row 1: .* km away .*conetl map revert"):
        take(conn, path, **IN_UTM)
    revert(conn, "1", map_name="default")
    assert not take(conn, path, crs="EPSG:32633", **SURVEYED).committed
    assert take(conn, path, **IN_UTM).committed
    stated = read(path, **IN_UTM).statements
    standing = sorted(feature.xyz_m for feature in read_current_features(conn))
    assert standing == sorted(statement.feature.xyz_m for statement in stated)
    conn.rollback()
    assert not take(conn, path, **IN_UTM).committed
    assert failed_audits(conn) == []


# --------------------------------------------------------------------------- layers


def two_layers(path, **more):
    """A GeoPackage with a cone in the layer `west` and two in `east`, and a table without places, as QGIS keeps its styles in."""
    layers = {"west": [[458000.0, 5428000.0]], "east": [[458100.0, 5428000.0], [458110.0, 5428000.0]]} | more
    for name, places in layers.items():
        points = shapely.to_wkb(shapely.points([[*place, 115.0] for place in places]))
        pyogrio.raw.write(
            path, points, [np.array(["2026-03-01T08:00:00"] * len(places), "datetime64[ms]")], ["last_seen_at"],
            geometry_type="Point Z", crs="EPSG:32632", layer=name, append=path.exists(), driver="GPKG",
        )  # fmt: skip
    style = [np.array(["<qgis/>"], object)]
    pyogrio.raw.write(path, None, style, ["styleQML"], geometry_type=None, layer="layer_styles", append=True)
    return path


def test_a_file_of_several_layers_is_not_taken_in_part(conn, tmp_path):
    path = two_layers(tmp_path / "two.gpkg")
    with pytest.raises(InputError, match=r"two\.gpkg has 2 layers with geometry: west, east; .*--layer"):
        take(conn, path)
    with pytest.raises(InputError, match=r"two\.gpkg has no layer north .*: west, east"):
        take(conn, path, layer="north")
    with pytest.raises(InputError, match=r"two\.gpkg has no layer layer_styles .*: west, east"):
        take(conn, path, layer="layer_styles")
    assert nothing_written(conn)


def test_layers_of_a_file_are_imports_of_their_own(conn, tmp_path):
    path = two_layers(tmp_path / "two.gpkg")
    assert take(conn, path, layer="west").counts[DeltaKind.ADDED] == 1
    assert take(conn, path, layer="east").counts[DeltaKind.ADDED] == 2
    assert len(read_current_features(conn)) == 3
    conn.rollback()
    assert not take(conn, path, layer="west").committed
    assert not take(conn, path, layer="east").committed
    assert {changeset.drive_id for changeset in list_changesets(conn)} == {"two.gpkg:west", "two.gpkg:east"}
    conn.rollback()
    assert failed_audits(conn) == []


def test_the_layer_that_an_import_took_before_there_was_a_choice_is_known_by_its_file(tmp_path):
    path = two_layers(tmp_path / "two.gpkg")
    west, east = (read(path, layer=name) for name in ("west", "east"))
    assert west.content_sha256 == file_sha256(path)
    assert len({west.content_sha256, east.content_sha256}) == 2


def test_a_file_with_one_layer_needs_no_choice(tmp_path, surveyed):
    folder, features = surveyed
    assert len(read(folder / "map.gpkg", layer="default").statements) == len(features)
    complaint(folder / "map.gpkg", r"map\.gpkg has no layer other .*: default", map_srid=None, layer="other")
    for name in ("map.csv", "map.parquet"):
        complaint(folder / name, r"map\..* has no layers: leave out --layer", layer="default")


def test_a_history_is_refused_as_one(conn, tmp_path):
    merge(conn, survey(0))
    for what, since in ((ExportContent.HISTORY, None), (ExportContent.CHANGES, datetime(2020, 1, 1, tzinfo=UTC))):
        export_map(conn, tmp_path / f"{what}.gpkg", "gpkg", ExportRequest(what=what, since=since))
        complaint(tmp_path / f"{what}.gpkg", "export of history or changes", map_srid=None)


# --------------------------------------------------------------------------- bad files


def point_features(rows):
    return [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": properties}
        for place, properties in rows
    ]


def geojson(path, rows, **members):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": point_features(rows)} | members))
    return path


GOOD = ([8.43, 49.01, 115.0], {"last_seen_at": "2026-03-01T08:00:00Z"})
OTHER = [8.431, 49.01, 115.0]
SEEN = GOOD[1]
ID = "7d0f4a53-29c9-4f3b-8f0e-0c1f3e0f2d11"
BAD = {
    "not a number": ([math.nan, 49.01, 115.0], SEEN, "row 2: an empty point where a point is expected"),
    "swapped": ([49.01, 8.431, 115.0], SEEN, r"row 2: .*swapped"),
    "swapped, out of range": ([-33.0, 151.2, 20.0], SEEN, r"row 2: .*swapped"),
    "no degrees": ([458000.0, 5428000.0, 115.0], SEEN, r"row 2: .*--crs wrong"),
    "elsewhere": ([120.0, 49.01, 115.0], SEEN, r"row 2: .*outside the area of use of the map's CRS EPSG:32632"),
    "no height": (OTHER[:2], SEEN, r"row 2: .*--ground-height-m"),
    "existence": (OTHER, SEEN | {"existence_probability": 1.2}, r"row 2: existence_probability is 1.2"),
    "negative sigma": (OTHER, SEEN | {"sigma_e_m": -0.1}, r"row 2: sigma_e_m is -0.1"),
    "no sigma": (OTHER, SEEN | {"sigma_u_m": 0.0}, r"row 2: sigma_u_m is 0"),
    "no time": (OTHER, SEEN | {"first_seen_at": "yesterday"}, r"row 2: first_seen_at is 'yesterday'"),
    "times crossed": (OTHER, SEEN | {"first_seen_at": "2026-03-02T08:00:00Z"}, "row 2: first_seen_at, last_seen_at"),
    "before 2000": (OTHER, SEEN | {"first_seen_at": "1980-01-06"}, "row 2: first_seen_at, '1980.*before 2000"),
    "in the future": (OTHER, SEEN | {"last_seen_at": "2199-01-01T00:00:00Z"}, "row 2: last_seen_at, '2199.*future"),
    "valid before 2000": (OTHER, SEEN | {"valid_from": "0001-01-01"}, "row 2: valid_from, '0001-01-01', is before"),
    "microseconds": (OTHER, SEEN | {"last_seen_at_us": 10**12}, "row 2: last_seen_at_us, 10{12}, is before 2000"),
    "same place": (GOOD[0], SEEN, "row 2: the same position as row 1"),
    "a formula": (OTHER, SEEN | {"category": "=1+1"}, r"row 2: category is '=1\+1', expected .*letters, digits"),
    "a formula of names": (OTHER, SEEN | {"category": "-A1"}, r"row 2: category is '-A1'"),
    "a formula that looks blank": (OTHER, SEEN | {"category": "\t@A1"}, r"row 2: category is '\\t@A1'"),
    "a category of two lines": (OTHER, SEEN | {"category": "cone\ncone"}, r"row 2: category is"),
    "a category of marks": (OTHER, SEEN | {"category": "<b>cone"}, r"row 2: category is '<b>cone'"),
    "no category": (OTHER, SEEN | {"category": ""}, r"row 2: category is ''"),
    "a blank category": (OTHER, SEEN | {"category": " "}, r"row 2: category is ' '"),
    "a long category": (OTHER, SEEN | {"category": "c" * 65}, r"row 2: category is 'c+', expected at most 64"),
    "a line class": (OTHER, SEEN | {"category": "Lane Marking"}, r"row 2: category is 'Lane Marking', .*lines cannot"),
    "no uuid": (OTHER, SEEN | {"feature_id": "cone 7"}, "row 1: feature_id is empty|row 2: feature_id is 'cone 7'"),
}


@pytest.mark.parametrize(
    ("srid", "places"),
    [
        (3460, [[178.44, -18.14], [179.99, -16.8], [-179.99, -16.8], [-178.8, -18.2]]),  # Fiji: 176.81 to -178.15
        (32760, [[177.0, -18.0], [179.999, -18.0], [-179.5, -18.0]]),  # 174 to 180
        (32701, [[-177.0, -18.0], [-179.999, -18.0], [179.5, -18.0]]),  # -180 to -174
        (2193, [[174.76, -36.85], [-179.9, -43.9]]),  # New Zealand: 166.37 to 178.63
    ],
)
def test_places_at_the_antimeridian_are_taken(tmp_path, srid, places):
    path = geojson(
        tmp_path / "far.geojson", [([lon + 1e-8, lat + 1e-8, 20.0], SEEN) for lon, lat in places]
    )  # not rounded
    found = read(path, map_srid=srid)
    back = Transformer.from_crs(srid, "OGC:CRS84", always_xy=True)
    for place, statement in zip(places, found.statements, strict=True):
        lon, lat = back.transform(*statement.feature.xyz_m[:2])
        assert [(lon - place[0] + 180) % 360 - 180, lat - place[1]] == pytest.approx([0, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("srid", "place"),
    [
        (3460, [170.0, -18.0]), (3460, [-170.0, -18.0]), (3460, [0.0, -18.0]), (3460, [179.0, 18.0]),
        (32760, [-174.0, -18.0]), (32701, [174.0, -18.0]), (32632, [-172.0, 49.0]),
    ],
)  # fmt: skip
def test_places_beyond_an_area_are_refused_at_the_antimeridian_too(tmp_path, srid, place):
    path = geojson(tmp_path / "far.geojson", [([*place, 20.0], SEEN)])
    complaint(path, f"row 1: .* is outside the area of use of the map's CRS EPSG:{srid}", map_srid=srid)


def nothing_written(conn):
    tables = ("map", "drive", "feature", "statement")
    counts = f"select {' + '.join(f'(select count(*) from conetl.{table})' for table in tables)} as n"
    written = execute(conn, counts)[0]["n"]
    conn.rollback()
    return written == 0


@pytest.mark.parametrize("name", BAD)
def test_a_bad_row_is_named(tmp_path, name):
    place, properties, message = BAD[name]
    complaint(geojson(tmp_path / "bad.geojson", [GOOD, (place, properties)]), message)


@pytest.mark.parametrize(
    "category", ["traffic_cone", "Leitkegel groß", "large-orange.cone 2", "कोन", "三角锥", "7", "c" * 64, None]
)
def test_categories_are_words_of_any_script(tmp_path, category):
    path = geojson(tmp_path / "good.geojson", [(GOOD[0], SEEN | {"category": category})])
    [statement] = read(path).statements
    assert statement.feature.category == (category or "traffic_cone")


@pytest.mark.parametrize("category", ["Traffic Cone", "TRAFFIC_CONE", "traffic-cone", " Traffic  cone "])
def test_a_known_class_may_be_spelled_otherwise(tmp_path, category):
    path = geojson(tmp_path / "good.geojson", [(GOOD[0], SEEN | {"category": category})])
    assert read(path).statements[0].feature.category == "traffic_cone"


@pytest.mark.parametrize(("name", "category"), [
    ("cone", "traffic_cone"), ("Leitkegel", "traffic_cone"), ("PYLON", "traffic_cone"), ("Leitbake", "vertical_panel"),
    ("barrel", "drum"), ("Absperrschranke", "barricade"), ("Verkehrszeichen", "traffic_sign"),
])  # fmt: skip
def test_common_names_of_classes_are_known(tmp_path, name, category):
    path = geojson(tmp_path / "good.geojson", [(GOOD[0], SEEN | {"category": name})])
    assert read(path).statements[0].feature.category == category


@pytest.mark.parametrize(("category", "up_m", "other"), [
    ("traffic_sign", 0.0, "work_zone_sign"), ("traffic_sign", 0.9, "traffic_sign"), ("Hinweistafel", 0.9, "Hinweistafel"),
    ("traffic_cone", 0.0, "traffic_sign"),
])  # fmt: skip
def test_signs_on_one_post_are_imported(conn, tmp_path, category, up_m, other):
    path = tmp_path / "signs.csv"
    rows = [f"458000.123,5428000.123,{115.012 + up},{name}" for up, name in ((0.0, category), (up_m, other))]
    path.write_text("\n".join(["easting_m,northing_m,ellipsoidal_height_m,category", *rows]))
    assert take(conn, path, **IN_UTM).counts[DeltaKind.ADDED] == 2


@pytest.mark.parametrize(("category", "up_m", "other"), [
    ("traffic_sign", 0.0, "traffic_sign"), ("traffic_cone", 0.9, "traffic_cone"), ("traffic_cone", 0.0, "drum"),
])  # fmt: skip
def test_one_object_in_two_rows_is_refused(tmp_path, category, up_m, other):
    path = tmp_path / "twice.csv"
    rows = [f"458000.123,5428000.123,{115.012 + up},{name}" for up, name in ((0.0, category), (up_m, other))]
    path.write_text("\n".join(["easting_m,northing_m,ellipsoidal_height_m,category", *rows]))
    complaint(path, "row 2: the same position as row 1; nothing was written", **IN_UTM)


def test_columns_of_csv_may_be_in_capitals(tmp_path):
    path = tmp_path / "capitals.csv"
    path.write_text("Name,Category,Easting,NORTHING,Ellipsoidal_Height_m\nP1,Drum,458000.123,5428000.123,115.012\n")
    assert read(path, **IN_UTM).statements[0].feature.category == "drum"
    path.write_text("Name,Easting,Northing,Height\nP1,458000.123,5428000.123,115.012\n")
    [point] = read_surveyed_points(path, 32632, crs="EPSG:32632", sigma_m=0.01)
    assert (point.name, point.xyz_m) == ("P1", pytest.approx((458000.123, 5428000.123, 115.012), abs=1e-4))


def test_swapped_eastings_and_northings_are_named(tmp_path):
    path = tmp_path / "swapped.csv"
    path.write_text("easting_m,northing_m,ellipsoidal_height_m\n5428000.12,458000.12,115.01\n")
    complaint(path, "row 1: .*EPSG:32632 .*: easting and northing are swapped; nothing", **IN_UTM)


@pytest.mark.parametrize(("apart_m", "category", "refused"), [
    (0.05, "traffic_cone", True), (0.2, "Traffic Cone", True), (0.3, "traffic_cone", False), (0.05, "traffic_sign", False),
])  # fmt: skip
def test_a_file_with_every_cone_twice_is_refused_unless_it_is_accepted(conn, tmp_path, apart_m, category, refused):
    places = [458000.01 + 6.13 * k + aside_m for aside_m in (0.0, apart_m) for k in range(4)]
    path = tmp_path / "two_surveys.csv"
    rows = [f"{east_m:.3f},5428000.123,115.012,{category}" for east_m in places]
    path.write_text("\n".join(["easting_m,northing_m,ellipsoidal_height_m,category", *rows]))
    if refused:
        with pytest.raises(
            InputError, match=r"8 of 8 cones are less than 0\.25 m from another.*--accept.*nothing was written"
        ):
            take(conn, path, **IN_UTM)
        assert nothing_written(conn)
    assert take(conn, path, accept=refused, **IN_UTM).counts[DeltaKind.ADDED] == 8


def test_ids_that_come_twice_are_named_and_nothing_is_written(conn, tmp_path):
    path = geojson(tmp_path / "bad.geojson", [(GOOD[0], SEEN | {"feature_id": ID}), (OTHER, SEEN | {"feature_id": ID})])
    with pytest.raises(InputError, match=f"row 2: feature_id {ID} is in row 1 already"):
        take(conn, path)
    assert nothing_written(conn)
    assert take(conn, geojson(tmp_path / "good.geojson", [GOOD, (OTHER, SEEN)])).committed


def test_files_that_are_none(conn, tmp_path, surveyed):
    folder, _ = surveyed

    def refused(name, content, message, **options):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            take(conn, path, **options)

    refused("empty.geojson", b"", "is empty")
    refused("none.geojson", b'{"type": "FeatureCollection", "features": []}', "no features|cannot be read")
    refused("cut.gpkg", (folder / "map.gpkg").read_bytes()[:3000], "cannot be read")
    refused("cut.parquet", (folder / "map.parquet").read_bytes()[:-100], "cannot be read as GeoParquet")
    refused("text.fgb", b"no FlatGeobuf at all", "not a FlatGeobuf")
    header = (folder / "map.fgb").read_bytes()
    refused(
        "claim.fgb", header[:8] + struct.pack("<I", 0xFFFFFFF0) + header[12:], "states a header of 4294967280 bytes"
    )
    refused("noheader.csv", b"a,b\n1,2\n", "no columns lon_deg")
    refused("two.csv", b"lon;lat\n8.4;49\n", "height of the ground .* and the time of the survey")
    refused("comma.csv", b"Longitude;Latitude\n8,4;49,x\n", "row 1: lat_deg is '49,x', which is not a number")
    refused("ragged.csv", b"lon_deg,lat_deg\n8.4,49\n8.4\n", "row 2: 1 values where the header has 2")
    refused("crs.csv", b"easting_m,northing_m\n458000,5428000\n", "give it with --crs")
    refused("map.kml", b"<kml/>", "can be imported from")
    refused("other.gpkg", (folder / "map.gpkg").read_bytes(), "which is right", crs="EPSG:32633")
    pq.write_table(pa.table({"a": [1]}), tmp_path / "plain.parquet")
    refused("plain2.parquet", (tmp_path / "plain.parquet").read_bytes(), "no `geo` metadata")
    assert nothing_written(conn)


def test_a_flatgeobuf_feature_without_geometry_is_refused(tmp_path):
    """GDAL hands over offsets out of bounds then, which crashed the process now and then."""
    path, places = tmp_path / "map.fgb", np.array([bytes(shapely.to_wkb(shapely.Point(8.43, 49))), None, None], object)
    words = [np.array(["traffic_cone"] * 3, object)]
    pyogrio.raw.write(
        path,
        places,
        words,
        ["category"],
        geometry_type="Point",
        crs="EPSG:4326",
        driver="FlatGeobuf",
        SPATIAL_INDEX="NO",
    )
    complaint(path, "from row 1 on: a feature has no geometry where a point is expected")


def test_a_file_that_claims_gigabytes_is_not_believed(tmp_path):
    """A geometry column of equal bytes: 3 GB of them are a few kB of Parquet."""
    geo = {"primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB"}}}
    schema = pa.schema({"geometry": pa.large_binary()}, {"geo": json.dumps(geo)})
    how = {"compression": "zstd", "use_dictionary": False, "write_statistics": False}
    with pq.ParquetWriter(tmp_path / "bomb.parquet", schema, **how) as writer:
        page = pa.table([pa.array([b"\0" * (64 << 20)], pa.large_binary())], schema=schema)
        for _ in range(33):
            writer.write_table(page)
    assert (tmp_path / "bomb.parquet").stat().st_size < 1 << 20
    complaint(tmp_path / "bomb.parquet", "states more than 2 GiB")


@pytest.mark.parametrize("name", ["map.geojson", "map.gpkg"])
@pytest.mark.parametrize("kind", ["VRT", "pipeline"])
def test_a_file_that_names_other_files_is_refused(tmp_path, name, kind):
    other = tmp_path / "private.csv"
    other.write_text("WKT,last_seen_at\nPOINT Z (8.43 49.01 115),2026-03-01T08:00:00Z\n")
    layer = f'<OGRVRTLayer name="private"><SrcDataSource>{other}</SrcDataSource></OGRVRTLayer>'
    command = f"gdal vector select {other} --fields last_seen_at"
    text = {
        "VRT": f"<OGRVRTDataSource>{layer}</OGRVRTDataSource>",
        "pipeline": json.dumps({"type": "gdal_streamed_alg", "command_line": command}),
    }
    (tmp_path / name).write_text(text[kind])
    complaint(tmp_path / name, rf"{name}.*not recognized", crs="EPSG:4326")
    with pytest.raises(InputError, match=rf"{name}.*not recognized"):
        read_vector_file(tmp_path / name)


def test_a_broken_geometry_is_named_by_its_row(tmp_path):
    geo = {"primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB"}}}
    points = [shapely.to_wkb(shapely.Point(8.43, 49.01, 115.0)), b"\x01\x01\x03\0\0"]
    table = pa.table({"geometry": points, "last_seen_at": [SEEN["last_seen_at"]] * 2})
    pq.write_table(table.replace_schema_metadata({"geo": json.dumps(geo)}), tmp_path / "map.parquet")
    complaint(tmp_path / "map.parquet", "row 2: no or a broken geometry where a point is expected")


def test_a_survey_before_2000_or_in_the_future_is_refused(tmp_path):
    path = geojson(tmp_path / "map.geojson", [(OTHER, {})])
    for year in (1970, 2199):
        complaint(path, f"--surveyed-at.*{year}.*(before 2000|future)", stated_at=datetime(year, 1, 2, tzinfo=UTC))


@pytest.mark.parametrize("option", ["--object-height-m", "--cone-height-m"])
def test_a_survey_of_a_date_lasts_until_the_end_of_the_day(conetl, conn, tmp_path, option):
    path = cones_csv(tmp_path / "plan.csv", DAYS[0][:1], ["last_seen_at"], [["2026-03-01T18:00:00Z"]])
    stated = ("--crs", "EPSG:32632", "--map-srid", 32632, "--surveyed-at", "2026-03-01", option, 0.75)
    assert "1 cone" in conetl("map", "import", path, *stated)
    [feature], [changeset] = read_current_features(conn), list_changesets(conn)
    assert feature.object_height_m == 0.75
    assert utc_from_ns(changeset.captured_to_ns) == datetime(2026, 3, 1, 23, 59, 59, 999999, UTC)


def test_rows_that_nobody_saw_at_the_survey_are_refused(tmp_path):
    """Drives may have removed them between."""
    path = geojson(tmp_path / "map.geojson", [(OTHER, SEEN)])
    seen = datetime.fromisoformat(SEEN["last_seen_at"])
    assert read(path, stated_at=seen + timedelta(hours=20)).stated_at_ns == ns_from_utc(seen + timedelta(hours=20))
    complaint(path, "--surveyed-at.*latest last_seen_at", stated_at=seen + timedelta(hours=49))


@pytest.mark.parametrize("name", ["map.geojson", "map.csv"])
def test_text_files_beyond_the_limits_are_refused(tmp_path, name):
    with (tmp_path / name).open("wb") as file:
        file.truncate(MAX_TEXT_BYTES + 1)
    complaint(tmp_path / name, rf"{name} has 536,870,913 bytes, expected at most")


def test_names_that_make_a_table_of_many_columns_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("conetl.readers.maps.tables.MAX_VALUES", 500_000)
    rows = [(GOOD[0], {f"p{100 * i + j}": 1 for j in range(100)}) for i in range(80)]  # 8,000 columns of 80 rows
    complaint(geojson(tmp_path / "wide.geojson", rows), "80 features with 8,000 columns, expected at most 500,000")


@pytest.mark.parametrize("depth", [60, 100_000])
def test_deeply_nested_geojson_is_refused(tmp_path, depth):
    nested = json.dumps(point_features([GOOD])[0])[:-2] + f', "a": {"[" * depth}{"]" * depth}' + "}}"
    (tmp_path / "deep.geojson").write_text(nested)
    complaint(tmp_path / "deep.geojson", r"deep\.geojson cannot be read as a map .*nest")


def test_a_new_map_wants_its_crs_stated(tmp_path):
    path = geojson(tmp_path / "good.geojson", [GOOD])
    complaint(path, r"--map-srid.*longitude 8\.4300, latitude 49\.0100, would be in EPSG:32632", map_srid=None)
    complaint(path, r"EPSG:4326 .* not a projected CRS in metres.*--map-srid", map_srid=4326)


def test_the_browser_shows_a_map_that_began_with_an_import(conn, own_view, surveyed):
    folder, features = surveyed
    take(conn, folder / "map.parquet")
    [changeset] = list_changesets(conn)
    conn.rollback()
    timeline = own_view.get("/api/maps/default/timeline").json()
    assert [(item["drive_id"], item["kind"]) for item in timeline["changesets"]] == [("map.parquet", "import")]
    way = own_view.get(f"/api/maps/default/drives/{changeset.drive_uuid}/trajectory").json()
    assert way["frame_index"] == []
    assert len(shown(own_view)["features"]) == len(features)


def test_an_own_export_adds_no_evidence(conn, surveyed, tmp_path):
    """Of this very map, in any format, and of one that began with an import; another format is not more evidence."""
    for day in range(2):
        merge(conn, survey(day))
    conn.commit()
    folder, _ = surveyed
    take(conn, folder / "map.csv", map_name="copy", params=NEW_IDS)
    conn.rollback()
    before, features = valid_time_map(conn), read_current_features(conn)
    for name in IMPORTABLE:
        own, copy = (tmp_path / f"{what}{FORMATS[name].suffix}" for what in ("own", "copy"))
        export_map(conn, own, name, ExportRequest())
        export_map(conn, copy, name, ExportRequest("copy"))
        conn.rollback()
        done = take(conn, own)
        assert (done.committed, done.own, sum(done.counts.values())) == (False, len(features), 0), name
        assert not take(conn, copy, map_name="copy").committed, name
    assert valid_time_map(conn) == before and len(list_changesets(conn)) == 2
    assert failed_audits(conn) == []


def test_edited_rows_of_an_own_export_count(conn, conetl, tmp_path):
    merge(conn, survey(0))
    conn.commit()
    features = read_current_features(conn)
    path = tmp_path / "edited.csv"
    export_map(conn, path, "csv", ExportRequest())
    header, first, *rest = path.read_text().splitlines()
    columns = header.split(",")
    values = first.split(",")
    values[columns.index("lat_deg")] = str(float(values[columns.index("lat_deg")]) + 1.2 / 111_000)
    values[columns.index("last_seen_at")] = "2026-03-20T00:00:00Z"
    path.write_text("\n".join([header, ",".join(values), *rest]) + "\n")
    conn.rollback()
    assert re.search(r"1 cone \(EPSG:\d+\): 1 \w+\.", conetl("map", "import", path))
    done = take(conn, path)
    assert (done.committed, done.own) == (False, len(features) - 1)
    assert failed_audits(conn) == []


@pytest.mark.parametrize("later", [(), (1,)])
def test_new_ids_warn_where_the_cones_of_the_map_stand_or_stood(conn, tmp_path, later):
    merge(conn, survey(0))
    conn.commit()
    exported = len(read_current_features(conn))
    path = tmp_path / "own.gpkg"
    export_map(conn, path, "gpkg", ExportRequest())
    conn.rollback()
    for day in later:
        merge(conn, survey(day))
        conn.commit()
    done = take(conn, path, params=NEW_IDS)
    assert done.committed and done.same_place == exported


def test_the_command_line(conetl, tmp_path, surveyed, monkeypatch):
    folder, features = surveyed
    assert "row 2: longitude" not in conetl("map", "import", geojson(tmp_path / "a.geojson", [GOOD]), code=2)
    done = json.loads(conetl("map", "import", folder / "map.gpkg", "--json"))
    assert (done["counts"]["added"], done["srid"], done["committed"]) == (len(features), 32632, True)
    layers = two_layers(tmp_path / "two.gpkg")
    assert "2 layers with geometry: west, east" in conetl("map", "import", layers, code=2).replace("\n", " ")
    assert json.loads(conetl("map", "import", layers, "--layer", "west", "--json"))["committed"]
    assert "CC0" in conetl("map", "licence", "CC0")
    written = json.loads(conetl("map", "export", "--format", "geoparquet", "--out", tmp_path / "a.parquet", "--json"))
    assert (written["features"], written["manifest"]["licence"]) == (len(features) + 1, "CC0")
    assert "exported from this map" in conetl("map", "import", tmp_path / "a.parquet")
    notes = []
    monkeypatch.setattr("conetl.cli.map.exchange.note", notes.append)
    classes = [(GOOD[0], SEEN | {"category": "Leitpfosten"}), (OTHER, SEEN | {"category": "drum"})]
    other = ("--map", "classes")
    conetl("map", "import", geojson(tmp_path / "classes.geojson", classes), "--map-srid", 32632, *other)
    assert "1 of 2 objects have a class that drives do not confirm or remove: Leitpfosten." in notes[0]
    assert "1 Leitpfosten, 1 drum" in conetl("map", "show", *other)
    [drum] = json.loads(conetl("map", "show", "--category", "drum", "--json", *other))["features"]
    assert drum["category"] == "drum"
