-- Purpose: stop believing, from now on in system time, that the versions which this changeset replaces are still open.
-- Parameters: committed_at (timestamptz).
update conetl.feature_version v
set system_period = tstzrange(lower(v.system_period), %(committed_at)s)
from open_version o
join delta_stage s using (feature_id)
where v.version_row_id = o.version_row_id and s.is_change;
