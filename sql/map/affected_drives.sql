-- Purpose: the drives that must be compared with the map again when some drives come, go or are judged otherwise: those that count
-- among them, every later one whose area meets one of theirs, and so on.
-- Parameters: drive_uuids (uuid[], of one map). Columns: drive_uuid, changeset_id, idempotency_key, in the order of the fold.
with recursive affected (drive_uuid) as (
    select unnest(%(drive_uuids)s::uuid[])
    union
    select later.drive_uuid
    from affected a
    join conetl.drive d using (drive_uuid)
    join conetl.active_drive later on later.map_id = d.map_id and later.area && d.area and ST_Intersects(later.area, d.area)
        and (later.captured_from_ns, later.content_sha256 collate "C") > (d.captured_from_ns, d.content_sha256 collate "C")
)
select d.drive_uuid, d.changeset_id, d.idempotency_key
from affected a
join conetl.active_drive d using (drive_uuid)
order by d.captured_from_ns, d.content_sha256 collate "C", d.idempotency_key collate "C";
