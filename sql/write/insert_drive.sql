-- Purpose: one ingested drive. Parameters: as the columns; captured_from/captured_to are the *_ns cut to microseconds.
insert into conetl.drive (
    drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig,
    captured_from_ns, captured_to_ns, captured_period, expected_frame_count
) values (
    %(drive_uuid)s, %(map_id)s, %(srid)s, %(drive_id)s, %(source_path)s, %(content_sha256)s, %(rig)s,
    %(captured_from_ns)s, %(captured_to_ns)s,
    tstzrange(%(captured_from)s, %(captured_to)s, '[]'), %(expected_frame_count)s
);
