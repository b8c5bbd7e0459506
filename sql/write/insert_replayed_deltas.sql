-- Purpose: write the staged deltas, believed from now on. Parameters: committed_at (timestamptz).
insert into conetl.delta (
    cell, changeset_id, feature_id, kind, old_version, new_version, track_index, changed_at_ns, changed_at, shift_m,
    other_feature_id, log_likelihood_ratio, existence_after, frames_seen, frames_empty, system_period
)
select
    f.cell, s.changeset_id, s.feature_id, s.kind, s.old_version, s.new_version, s.track_index, s.changed_at_ns, s.changed_at, s.shift_m,
    s.other_feature_id, s.log_likelihood_ratio, s.existence_after, s.frames_seen, s.frames_empty,
    tstzrange(%(committed_at)s, null)
from replayed_delta_stage s
left join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0  -- a missing one is an error, not a row less
order by f.cell, s.feature_id, s.changed_at_ns;
