-- Purpose: a drive that is being watched, with the frame pairs taken so far. Parameters: watch_id, map_name, srid, drive_id, source_path,
-- captured_from_ns, captured_to_ns (UTC ns of the pairs taken), frame_pair_count.
insert into conetl.watched_drive (
    watch_id, map_name, srid, drive_id, source_path, captured_from_ns, captured_to_ns, frame_pair_count
)
values (
    %(watch_id)s, %(map_name)s, %(srid)s, %(drive_id)s, %(source_path)s, %(captured_from_ns)s, %(captured_to_ns)s,
    %(frame_pair_count)s
)
on conflict (watch_id) do update
set captured_to_ns = excluded.captured_to_ns, frame_pair_count = excluded.frame_pair_count, updated_at = clock_timestamp();
