-- Purpose: write the staged deltas, believed from now on. Parameters: committed_at (timestamptz).
insert into conetl.delta (
    changeset_id, feature_id, kind, old_version, new_version, track_index, changed_at_ns, changed_at, shift_m, system_period
)
select
    s.changeset_id, s.feature_id, s.kind, s.old_version, s.new_version, s.track_index, s.changed_at_ns, s.changed_at, s.shift_m,
    tstzrange(%(committed_at)s, null)
from replayed_delta_stage s;
