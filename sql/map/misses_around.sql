-- Purpose: every drive that looked in vain, as it is believed now, for features that ever stood around the paths of some drives.
-- Parameters: drive_uuids (uuid[], of one map). Columns: as Miss, then drive_uuid and the drive's place in the fold:
-- captured_from_ns, content_sha256, idempotency_key.
select
    x.feature_id, x.changeset_id, x.old_version, x.existence_after, x.changed_at_ns,
    d.drive_uuid, d.captured_from_ns, d.content_sha256, c.idempotency_key
from conetl.delta x
join conetl.changeset c on c.changeset_id = x.changeset_id
join conetl.drive d on d.drive_uuid = c.drive_uuid
where x.kind = 'missed' and upper_inf(x.system_period)
and (x.cell, x.feature_id) in (
    select w.cell, w.feature_id
    from conetl.drive a
    cross join lateral conetl.pieces(a.area) piece
    join conetl.feature_version w on w.map_id = a.map_id and w.geom && piece and ST_Intersects(w.geom, piece)
    where a.drive_uuid = any(%(drive_uuids)s) and upper_inf(w.system_period)
)
order by x.feature_id, x.changeset_id;
