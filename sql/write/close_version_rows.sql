-- Purpose: stop believing some versions from now on in system time. Parameters: committed_at (timestamptz), row_ids (bigint[]).
update conetl.feature_version v
set system_period = tstzrange(lower(v.system_period), %(committed_at)s)
where v.version_row_id = any(%(row_ids)s);
