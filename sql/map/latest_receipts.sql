-- Purpose: the last receipt of every drive of a map. Parameters: map_name, headers (text[], null: all).
-- Columns: as Receipt; attempts counts how often work on the drive was started.
select
    r.attempt_id, r.map_name, r.drive_path, r.drive_id, r.header_sha256, r.analysis_sha256, r.content_sha256, r.state, r.reason,
    r.may_pass, r.changeset_id, r.frame_pairs, r.seconds, r.flow_run_id, r.host, r.at,
    (
        select count(*)
        from conetl.receipt s
        where s.map_name = r.map_name and s.header_sha256 = r.header_sha256 and s.state = 'started'
    ) as attempts
from conetl.latest_receipt r
where r.map_name = %(map_name)s and (%(headers)s::text[] is null or r.header_sha256 = any(%(headers)s::text[]))
order by r.receipt_no;
