-- Purpose: what some drives did, as it is believed now. Parameters: drive_uuids (uuid[]).
-- Columns: delta_row_id, changeset_id, feature_id, kind, old_version, new_version, track_index, changed_at_ns, shift_m,
-- other_feature_id, log_likelihood_ratio, existence_after, frames_seen, frames_empty.
select
    x.delta_row_id, x.changeset_id, x.feature_id, x.kind, x.old_version, x.new_version, x.track_index, x.changed_at_ns, x.shift_m,
    x.other_feature_id, x.log_likelihood_ratio, x.existence_after, x.frames_seen, x.frames_empty
from conetl.changeset c
join conetl.delta x on x.changeset_id = c.changeset_id
where c.drive_uuid = any(%(drive_uuids)s) and upper_inf(x.system_period)
order by x.changeset_id, x.feature_id;
