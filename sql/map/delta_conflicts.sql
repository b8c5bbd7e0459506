-- Purpose: staged deltas that do not fit the map as it is: the map was changed since it was read. Zero rows = all fit.
-- Parameters: map_id. Columns: feature_id, kind, old_version (expected), version (found), present (found; suppressed
-- ones stand for the comparison of drives).
select s.feature_id, s.kind, s.old_version, o.version, o.present
from delta_stage s
left join open_version o using (feature_id)
where case
    when o.map_id <> %(map_id)s then true
    when s.kind in ('added', 'split') then coalesce(o.present, false)
    else not coalesce(o.present and o.version = s.old_version, false)
end
limit 10;
