-- Purpose: stop believing, from now on in system time, that the versions which this changeset replaces are still open.
-- any(array(...)): one look into the primary key each; a join would read the primary key from its start to the last of them.
-- Parameters: committed_at (timestamptz).
update conetl.feature_version v
set system_period = tstzrange(lower(v.system_period), %(committed_at)s)
where v.version_row_id = any(
    array(select o.version_row_id from open_version o join delta_stage s using (feature_id) where s.is_change)
);
