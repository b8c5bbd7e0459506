-- Purpose: the recordings that a map was made of, those that a person took back included.
-- Parameters: map_name. Columns: drive_id, captured_from_ns, captured_to_ns (UTC), params_sha256, model_sha256, changeset_no,
-- committed_at, headers (text[]: of the folders that receipts say it came from; empty: it was ingested by hand).
select
    d.drive_id, d.captured_from_ns, d.captured_to_ns, c.params_sha256, c.model_sha256, c.changeset_no, c.committed_at,
    array(
        select distinct r.header_sha256
        from conetl.receipt r
        where r.map_name = m.map_name and r.changeset_id = c.changeset_id
    ) as headers
from conetl.changeset c
join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = d.map_id
where m.map_name = %(map_name)s
order by c.changeset_no;
