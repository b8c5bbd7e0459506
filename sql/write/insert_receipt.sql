-- Purpose: one receipt; nothing where the attempt has one of this kind already.
-- Parameters: attempt_id, map_name, drive_path, drive_id, header_sha256, analysis_sha256, content_sha256, state, reason, may_pass,
-- changeset_id, frame_pairs, seconds, flow_run_id, host.
insert into conetl.receipt (
    attempt_id, map_name, drive_path, drive_id, header_sha256, analysis_sha256, content_sha256, state, reason, may_pass,
    changeset_id, frame_pairs, seconds, flow_run_id, host
)
values (
    %(attempt_id)s, %(map_name)s, %(drive_path)s, %(drive_id)s, %(header_sha256)s, %(analysis_sha256)s, %(content_sha256)s,
    %(state)s, %(reason)s, %(may_pass)s, %(changeset_id)s, %(frame_pairs)s, %(seconds)s, %(flow_run_id)s, %(host)s
)
on conflict (attempt_id, (state = 'started')) do nothing;
