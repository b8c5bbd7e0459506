-- Purpose: the version of each staged feature that is believed and open now (features of any map; conflicts are looked for next).
-- One look into feature_version_believed for each, whatever the planner thinks of the tables' sizes (offset 0 keeps it from joining them
-- otherwise): it would read the whole table, or go through the exclusion constraint's index, which takes a dozen pages each.
-- Columns: feature_id, map_id, version_row_id, version, present (or suppressed), valid_from (timestamptz), valid_from_ns.
create temporary table open_version on commit drop as
select v.*
from delta_stage s
cross join lateral (
    select
        w.feature_id, w.map_id, w.version_row_id, w.version, w.present or w.suppressed as present,
        lower(w.valid_period) as valid_from, w.valid_from_ns
    from conetl.feature_version w
    where w.feature_id = s.feature_id and coalesce(upper(w.system_period), 'infinity') = 'infinity' and upper_inf(w.valid_period)
    offset 0
) v;
