-- Purpose: changesets of drives whose events were not handed to Prefect, oldest first. An import or a decision has no events.
-- Parameters: map_name; quiet_s: those of the last so many seconds are left to the runs that committed them.
-- Columns: idempotency_key, map_srid (EPSG), content_sha256 (of the drive), expected_frame_count (of the drive).
select c.idempotency_key, m.srid as map_srid, d.content_sha256, d.expected_frame_count
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
where m.map_name = %(map_name)s and d.kind = 'drive'
  and c.committed_at <= clock_timestamp() - make_interval(secs => %(quiet_s)s)
  and not exists (select from conetl.changeset_told t where t.changeset_id = c.changeset_id)
order by c.changeset_no;
