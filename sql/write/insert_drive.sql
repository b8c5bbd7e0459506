-- Purpose: one ingested drive, unless it is there. Parameters: as the columns; captured_from/captured_to are the *_ns cut to
-- microseconds; path_wkt: its path (line, map CRS), which area covers with room to spare: circles are drawn as polygons inside.
insert into conetl.drive (
    drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig,
    captured_from_ns, captured_to_ns, captured_period, expected_frame_count,
    reconcile, influence_m, absence_figures, area
)
select
    %(drive_uuid)s, %(map_id)s, %(srid)s, %(drive_id)s, %(source_path)s, %(content_sha256)s, %(rig)s,
    %(captured_from_ns)s, %(captured_to_ns)s,
    tstzrange(%(captured_from)s, %(captured_to)s, '[]'), %(expected_frame_count)s,
    %(reconcile)s, %(influence_m)s, %(absence_figures)s, ST_Buffer(ST_GeomFromText(%(path_wkt)s, %(srid)s), 1.05 * %(influence_m)s + 5)
where not exists (select from conetl.drive d where d.drive_uuid = %(drive_uuid)s)
on conflict (drive_uuid) do nothing;
