-- Purpose: an imported map as an event of the fold, unless it is there. Parameters: drive_uuid, map_id, srid, drive_id (name of the
-- file), source_path, content_sha256, reconcile (JSON), influence_m: as the columns; stated_at_ns, stated_at: the instant for which it
-- speaks (the latter cut to microseconds); cells_wkt: points (map CRS) so that every cone is within cell_m of one.
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
