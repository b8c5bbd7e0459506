-- Purpose: whether this server has a database of this name. Parameters: name. Columns: found.
select exists (select from pg_database where datname = %(name)s) as found;
