-- Purpose: which of the named roles exist and may read the map. Parameters: names (text[]). Columns: rolname.
select rolname::text as rolname
from pg_roles
where rolname = any(%(names)s)
and has_schema_privilege(oid, 'conetl', 'usage') and has_table_privilege(oid, 'conetl.feature_version', 'select');
