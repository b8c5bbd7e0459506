-- Purpose: whether new versions make the planner's picture of their table wrong. Parameters: versions (written since).
-- Columns: outgrown.
select 10 * %(versions)s >= c.reltuples as outgrown
from pg_class c
where c.oid = 'conetl.feature_version'::regclass;
