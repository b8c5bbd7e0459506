-- Purpose: the version of each staged feature that is believed and open now (features of any map; conflicts are looked for next).
-- Columns: feature_id, map_id, version_row_id, version, present (or suppressed), valid_from (timestamptz), valid_from_ns.
create temporary table open_version on commit drop as
select
    v.feature_id, v.map_id, v.version_row_id, v.version, v.present or v.suppressed as present, lower(v.valid_period) as valid_from, v.valid_from_ns
from delta_stage s
join conetl.feature_version v using (feature_id)
where upper_inf(v.system_period) and upper_inf(v.valid_period);
