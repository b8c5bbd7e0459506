-- Purpose: migrations of this database. Columns: name, sha256.
select name, sha256 from conetl.schema_migration order by name;
