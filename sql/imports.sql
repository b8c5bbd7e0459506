-- Imported maps: events of the fold like drives, with statements instead of tracks.

-- name: insert_import
-- An imported map as an event of the fold, unless it exists.
-- Parameters: drive_uuid, map_id, srid, drive_id (name of the file), source_path, content_sha256, reconcile (JSON),
-- influence_m: as the columns; stated_at_ns, stated_at: the instant that it describes (the latter cut to microseconds);
-- cells_wkt: points (map CRS) so that every cone is within cell_m of one.
insert into conetl.drive (
    drive_uuid, map_id, srid, kind, drive_id, source_path, content_sha256, rig,
    captured_from_ns, captured_to_ns, captured_period, expected_frame_count,
    reconcile, influence_m, area
) values (
    %(drive_uuid)s, %(map_id)s, %(srid)s, 'import', %(drive_id)s, %(source_path)s, %(content_sha256)s, null,
    %(stated_at_ns)s, %(stated_at_ns)s, tstzrange(%(stated_at)s, %(stated_at)s, '[]'), 0,
    %(reconcile)s, %(influence_m)s, ST_Buffer(ST_GeomFromText(%(cells_wkt)s, %(srid)s), 1.05 * (%(influence_m)s + %(cell_m)s) + 1)
)
on conflict (drive_uuid) do nothing;

-- name: statements
-- What an imported map states. Parameters: drive_uuid. Columns: as MapFeature of version 1, then valid_from_ns.
select
    s.feature_id, 1, s.category, ST_X(s.geom), ST_Y(s.geom), ST_Z(s.geom),
    s.cov_xx, s.cov_xy, s.cov_xz, s.cov_yy, s.cov_yz, s.cov_zz,
    ST_X(s.geom), ST_Y(s.geom), ST_Z(s.geom) + s.cone_height_m / 2,
    s.cone_height_m, s.cone_height_sigma_m, s.existence_probability, s.observation_count, s.first_seen_ns, s.last_seen_ns,
    null::bytea, s.valid_from_ns
from conetl.statement s
where s.drive_uuid = %(drive_uuid)s
order by s.statement_index;
