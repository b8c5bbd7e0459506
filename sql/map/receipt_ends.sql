-- Purpose: how attempts ended. Parameters: attempt_ids (uuid[]). Columns: as Receipt.
select
    r.attempt_id, r.map_name, r.drive_path, r.drive_id, r.header_sha256, r.analysis_sha256, r.content_sha256, r.state, r.reason,
    r.may_pass, r.changeset_id, r.frame_pairs, r.seconds, r.flow_run_id, r.host, r.at
from conetl.receipt r
where r.attempt_id = any(%(attempt_ids)s::uuid[]) and r.state <> 'started'
order by r.receipt_no;
