-- Purpose: stop believing some deltas from now on in system time. Parameters: committed_at (timestamptz), row_ids (bigint[]).
update conetl.delta x
set system_period = tstzrange(lower(x.system_period), %(committed_at)s)
where x.delta_row_id = any(%(row_ids)s);
