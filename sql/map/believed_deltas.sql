-- Purpose: what some drives did, as it is believed now. Parameters: drive_uuids (uuid[]).
-- Columns: delta_row_id, changeset_id, feature_id, kind, old_version, new_version, track_index, changed_at_ns, shift_m.
select
    x.delta_row_id, x.changeset_id, x.feature_id, x.kind, x.old_version, x.new_version, x.track_index, x.changed_at_ns, x.shift_m
from conetl.changeset c
join conetl.delta x on x.changeset_id = c.changeset_id
where c.drive_uuid = any(%(drive_uuids)s) and upper_inf(x.system_period)
order by x.changeset_id, x.feature_id;
