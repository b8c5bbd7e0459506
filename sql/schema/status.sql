-- Purpose: facts about the server and the database.
-- Columns: database, username, postgres_version, postgis_version (null: not installed), has_schema, has_map, size_bytes.
select
    current_database()::text as database,
    current_user::text as username,
    current_setting('server_version') as postgres_version,
    (select extversion from pg_extension where extname = 'postgis') as postgis_version,
    to_regclass('conetl.schema_migration') is not null as has_schema,
    to_regclass('conetl.map') is not null as has_map,
    pg_database_size(current_database()) as size_bytes;
