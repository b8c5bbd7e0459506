-- Purpose: changesets of a map, newest first, or the one of an idempotency key.
-- Parameters: map_name, idempotency_key (null: all), max_rows (null: all).
-- Columns: as CommittedChangeset.
select
    c.changeset_no, c.changeset_id, d.drive_id, c.drive_uuid, c.idempotency_key, c.params_sha256, c.model_sha256, c.code_version,
    c.committed_at, c.added_count, c.confirmed_count, c.moved_count, c.removed_count,
    c.missed_count, c.height_changed_count, c.split_count, c.merged_count,
    c.frame_pair_count, c.detection_count, c.match_count, c.position_count, c.track_count, c.rejection_count,
    d.captured_from_ns, d.captured_to_ns,
    exists (select from conetl.active_drive a where a.changeset_id = c.changeset_id) as counts
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
where m.map_name = %(map_name)s and (%(idempotency_key)s::text is null or c.idempotency_key = %(idempotency_key)s)
order by c.changeset_no desc
limit %(max_rows)s;
