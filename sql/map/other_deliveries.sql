-- Purpose: the changesets that count of the same recording as it was delivered otherwise: equal id, the first or the last frame pair of
-- the same nanosecond, other content. Imported maps, which have no rig, are no recordings.
-- Parameters: map_name, drive_id, captured_from_ns, captured_to_ns (UTC), content_sha256. Columns: changeset_no.
select d.changeset_no
from conetl.active_drive d
join conetl.map m on m.map_id = d.map_id
where m.map_name = %(map_name)s and d.rig is not null and d.drive_id = %(drive_id)s
and (d.captured_from_ns = %(captured_from_ns)s or d.captured_to_ns = %(captured_to_ns)s)
and d.content_sha256 <> %(content_sha256)s
order by d.changeset_no;
