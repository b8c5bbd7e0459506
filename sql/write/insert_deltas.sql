-- Purpose: the deltas themselves. Parameters: changeset_id, committed_at (timestamptz).
insert into conetl.delta (
    cell, changeset_id, feature_id, kind, old_version, new_version, track_index, changed_at_ns, changed_at, shift_m,
    other_feature_id, log_likelihood_ratio, existence_after, frames_seen, frames_empty, system_period
)
select
    coalesce(o.cell, (select f.cell from conetl.feature f where f.feature_id = s.feature_id and f.map_id > 0)),
    %(changeset_id)s, s.feature_id, s.kind, s.old_version,
    case when s.is_change then coalesce(o.version, 0) + 1 else s.old_version end,
    s.track_index, s.changed_at_ns, s.changed_at, s.shift_m,
    s.other_feature_id, s.log_likelihood_ratio, s.existence_after, s.frames_seen, s.frames_empty,
    tstzrange(%(committed_at)s, null)
from delta_stage s
left join open_version o using (feature_id)
order by 1, s.feature_id;
