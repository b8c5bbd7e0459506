-- Purpose: the changeset itself, with the counts that an audit compares with the rows. Parameters: as the columns.
-- Columns: changeset_no.
insert into conetl.changeset (
    changeset_id, map_id, drive_uuid, run_id, idempotency_key, params_sha256, model_sha256, code_version, committed_at,
    added_count, confirmed_count, moved_count, removed_count, missed_count, height_changed_count, split_count, merged_count,
    frame_pair_count, detection_count, match_count, position_count, track_count, rejection_count
) values (
    %(changeset_id)s, %(map_id)s, %(drive_uuid)s, %(run_id)s, %(idempotency_key)s, %(params_sha256)s, %(model_sha256)s,
    %(code_version)s, %(committed_at)s,
    %(added_count)s, %(confirmed_count)s, %(moved_count)s, %(removed_count)s,
    %(missed_count)s, %(height_changed_count)s, %(split_count)s, %(merged_count)s,
    %(frame_pair_count)s, %(detection_count)s, %(match_count)s, %(position_count)s, %(track_count)s, %(rejection_count)s
)
returning changeset_no;
