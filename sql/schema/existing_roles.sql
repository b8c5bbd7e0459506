-- Purpose: which of the named roles exist. Parameters: names (text[]). Columns: rolname.
select rolname::text as rolname from pg_roles where rolname = any(%(names)s);
