-- The schema's own bookkeeping: migrations, roles, extensions, session settings.

-- name: schema_migration
-- The table of applied migrations. Runs before every migration; harmless if it exists.
create schema if not exists conetl;
create table if not exists conetl.schema_migration (
    name       text primary key,
    sha256     text not null,
    applied_at timestamptz not null default clock_timestamp()
);

-- name: applied_migrations
-- Migrations of this database. Columns: name, sha256.
select name, sha256 from conetl.schema_migration order by name;

-- name: insert_migration
-- Record an applied migration. Parameters: name; sha256 (hex, of the file).
insert into conetl.schema_migration (name, sha256) values (%(name)s, %(sha256)s);

-- name: functions_sha256
-- Hash of the files from which the views and functions were made last. Columns: sha256; no row in a new database.
select sha256 from conetl.schema_functions order by applied_at desc limit 1;

-- name: record_functions
-- Record from which files the views and functions were made. Parameters: sha256 (hex).
insert into conetl.schema_functions (sha256) values (%(sha256)s);

-- name: session
-- Settings of a session that would change numbers, times or texts if a server, a database or a user had others; and the
-- search path, so that it finds conetl's tables and PostGIS's functions, in whichever schema PostGIS is installed. Columns:
-- server_pid; search_path; settings (their number).
select
    pg_backend_pid() as server_pid,
    set_config(
        'search_path',
        'conetl, public' || coalesce((
            select string_agg(distinct ', ' || quote_ident(n.nspname), '')
            from pg_extension e
            join pg_namespace n on n.oid = e.extnamespace
            where e.extname in ('postgis', 'btree_gist') and n.nspname <> 'public'
        ), ''),
        false
    ) as search_path,
    (
        select count(set_config(wanted.name, wanted.value, false))
        from (
            values
            ('extra_float_digits', '1'), -- all digits
            ('timezone', 'UTC'),
            ('datestyle', 'ISO, MDY'),
            ('intervalstyle', 'postgres'),
            ('bytea_output', 'hex'),
            ('standard_conforming_strings', 'on'),
            ('array_nulls', 'on'),
            ('transform_null_equals', 'off'),
            ('default_transaction_isolation', 'read committed')
        ) as wanted (name, value)
    ) as settings;

-- name: status
-- Facts about the server and the database; postgis_version is null where it is not installed.
select
    current_database()::text as database,
    current_user::text as username,
    current_setting('server_version') as postgres_version,
    (select extversion from pg_extension where extname = 'postgis') as postgis_version,
    to_regclass('conetl.schema_migration') is not null as has_schema,
    to_regclass('conetl.map') is not null as has_map,
    pg_database_size(current_database()) as size_bytes;

-- name: missing_extensions
-- Extensions that conetl needs and the server does not offer. Columns: name.
select needed.name
from (values ('postgis'), ('btree_gist')) as needed (name)
where not exists (select from pg_available_extensions a where a.name = needed.name);

-- name: roles
-- The two group roles and their rights; grant one of them to a login. Runs again after every migration.
-- conetl_reader may only SELECT. conetl_writer may add rows, close system periods and set a map's licence; it may
-- neither change nor delete history. Base layers and provisional features are not history, so conetl_writer may drop
-- them.
-- Needs the right to create roles (superuser or CREATEROLE).
do $$
declare
    role_name text;
begin
    foreach role_name in array array['conetl_reader', 'conetl_writer'] loop
        begin
            if not exists (select from pg_roles where rolname = role_name) then
                execute format('create role %%I nologin', role_name);
            end if;
        exception when duplicate_object or unique_violation then
            null;  -- made by another database of this server at the same moment
        end;
    end loop;
end
$$;
revoke all on all tables in schema conetl from conetl_reader, conetl_writer;
grant usage on schema conetl to conetl_reader, conetl_writer;
grant select on all tables in schema conetl to conetl_reader, conetl_writer;
grant insert on all tables in schema conetl to conetl_writer;
grant update (system_period) on conetl.feature_version, conetl.delta, conetl.hold, conetl.plan to conetl_writer;
grant update (licence, map_name, id_name) on conetl.map to conetl_writer;  -- not a state of the road
grant update (pruned_at, archive_path) on conetl.drive to conetl_writer;  -- archived records are restored when they are needed
grant update (map_name) on conetl.receipt to conetl_writer;  -- a map may be renamed, but only its owner deletes it
grant delete on conetl.base_source, conetl.base_tile, conetl.base_line to conetl_writer;  -- see the baseline
grant update, delete on conetl.feature_cell to conetl_writer;  -- follows from feature_version, see conetl.count_cells
-- What a drive shows while it is recorded is not history either, see conetl.watched_drive.
grant update, delete on conetl.watched_drive, conetl.provisional_feature to conetl_writer;
grant update on conetl.notice_round, conetl.notice_delivery to conetl_writer;  -- no history either
revoke insert on conetl.schema_migration, conetl.schema_functions from conetl_writer;
do $$
begin
    execute format('grant temporary on database %%I to conetl_writer', current_database());
end
$$;

-- name: ready_roles
-- Which of the named roles exist and may read the map. Parameters: names (text[]). Columns: rolname.
select rolname::text as rolname
from pg_roles
where rolname = any(%(names)s)
and has_schema_privilege(oid, 'conetl', 'usage') and has_table_privilege(oid, 'conetl.feature_version', 'select');

-- name: may_commit
-- Whether the connected user may write changesets. Columns: may_commit.
select has_table_privilege('conetl.changeset', 'insert') as may_commit;

-- name: may_create_roles
-- Whether the connected user may create roles. Columns: may_create_roles.
select rolsuper or rolcreaterole as may_create_roles from pg_roles where rolname = current_user;

-- name: database_exists
-- Whether this server has a database of this name. Parameters: name. Columns: found.
select exists (select from pg_database where datname = %(name)s) as found;

-- name: create_prefect_database
-- A separate database for the Prefect server. Needs the right to create databases.
create database prefect;

-- name: reader_session
-- Make a session read-only with a time limit per statement, as conetl_reader where the user is a member of it.
-- Parameters: timeout (interval text). Columns: role (null where the session keeps its user).
select
    set_config('default_transaction_read_only', 'on', false) as read_only,
    set_config('statement_timeout', %(timeout)s, false) as timeout,
    (
        select set_config('role', r.rolname, false) from pg_roles r
        where r.rolname = 'conetl_reader' and pg_has_role(current_user, r.oid, 'MEMBER')
    ) as role;
