-- The outcome of every drive that was submitted.

-- name: insert_receipt
-- Insert one receipt, unless the attempt already has one of this kind. Parameters: as the columns.
insert into conetl.receipt (
    attempt_id, map_name, drive_path, drive_id, header_sha256, analysis_sha256, content_sha256, state, reason, may_pass,
    changeset_id, frame_pairs, seconds, flow_run_id, host
)
values (
    %(attempt_id)s, %(map_name)s, %(drive_path)s, %(drive_id)s, %(header_sha256)s, %(analysis_sha256)s, %(content_sha256)s,
    %(state)s, %(reason)s, %(may_pass)s, %(changeset_id)s, %(frame_pairs)s, %(seconds)s, %(flow_run_id)s, %(host)s
)
on conflict (attempt_id, (state = 'started')) do nothing;

-- name: latest_receipts
-- The last receipt of drives of a map, except of those whose map was set aside. Parameters: map_name; headers (text[]).
-- Columns: as Receipt; attempts counts how often work on the drive was started.
select
    {{receipt columns of r}},
    (
        select count(*)
        from conetl.receipt s
        where s.map_name = r.map_name and s.header_sha256 = r.header_sha256 and s.state = 'started'
    ) as attempts
from conetl.latest_receipt r
where r.map_name = %(map_name)s and r.header_sha256 = any(%(headers)s::text[])
and not exists (
    select
    from conetl.changeset c
    join conetl.map m using (map_id)
    where c.changeset_id = r.changeset_id and m.map_name <> r.map_name
)
order by r.receipt_no;

-- name: under_way
-- Drives of a map whose last receipt says that work began. Parameters: map_name. Columns: drive_id, header_sha256.
select r.drive_id, r.header_sha256 from conetl.latest_receipt r where r.map_name = %(map_name)s and r.state = 'started';

-- name: receipt_ends
-- How attempts ended. Parameters: attempt_ids (uuid[]). Columns: as Receipt.
select {{receipt columns of r}}
from conetl.receipt r
where r.attempt_id = any(%(attempt_ids)s::uuid[]) and r.state <> 'started'
order by r.receipt_no;

-- name: pairs_per_second
-- How fast recent drives were ingested: the median of the last 200 that were committed.
-- Parameters: map_name. Columns: pairs_per_second (null: none was timed).
select percentile_cont(0.5) within group (order by timed.frame_pairs / timed.seconds) as pairs_per_second
from (
    select r.frame_pairs, r.seconds
    from conetl.receipt r
    where r.map_name = %(map_name)s and r.state in ('committed', 'held') and r.seconds > 0 and r.frame_pairs > 0
    order by r.receipt_no desc
    limit 200
) as timed;

-- name: headers_by_changeset
-- Header hashes of the folders that became changesets of a map. Parameters: map_name. Columns: changeset_id, headers (text[]).
select changeset_id, array_agg(distinct header_sha256) as headers
from conetl.receipt
where map_name = %(map_name)s and changeset_id is not null
group by changeset_id;
