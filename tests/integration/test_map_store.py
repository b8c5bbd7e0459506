"""The map store on a real PostGIS: commits, versions, history, conflicts."""

from __future__ import annotations

from conetl.io.map_store import feature_log, find_changeset, list_changesets, map_summary, read_current_features


def test_first_drive_makes_the_map(conn, samples):
    feature = samples.feature()
    result = samples.commit(conn, samples.added(feature), key="1")
    assert result.committed
    assert result.versions_written == 1
    assert (result.changeset.added_count, result.changeset.position_count) == (1, 3)
    assert read_current_features(conn) == [feature]
    summary = map_summary(conn)
    assert (summary.srid, summary.feature_count, summary.changeset_count) == (samples.SRID, 1, 1)
    assert find_changeset(conn, "1" * 64) == result.changeset
    assert list_changesets(conn) == [result.changeset]
    [entry] = feature_log(conn, feature.feature_id)
    assert (entry.kind, entry.new_version, entry.height_m) == ("added", 1, 114.5)
