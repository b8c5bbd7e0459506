-- Purpose: the two group roles and what they may do; grant one of them to a login. Run again after every migration.
-- conetl_reader may only SELECT. conetl_writer may add rows, close system periods and set a map's licence; it may neither change nor
-- delete history. Base layers and provisional features are no history: conetl_writer may drop them.
-- Needs the right to create roles (superuser or CREATEROLE).
do $$
declare
    role_name text;
begin
    foreach role_name in array array['conetl_reader', 'conetl_writer'] loop
        begin
            if not exists (select from pg_roles where rolname = role_name) then
                execute format('create role %I nologin', role_name);
            end if;
        exception when duplicate_object or unique_violation then
            null;  -- made by another database of this server at the same moment
        end;
    end loop;
end
$$;
revoke all on all tables in schema conetl from conetl_reader, conetl_writer;
grant usage on schema conetl, conetl_ogc to conetl_reader, conetl_writer;
grant select on all tables in schema conetl to conetl_reader, conetl_writer;
grant insert on all tables in schema conetl to conetl_writer;
grant update (system_period) on conetl.feature_version, conetl.delta to conetl_writer;
grant update (licence) on conetl.map to conetl_writer;  -- says what others may do with the data, nothing of the road
grant delete on conetl.base_source, conetl.base_tile, conetl.base_line to conetl_writer;  -- no history, see 0005
-- What a drive shows while it is recorded is no history either, see conetl.watched_drive.
grant update, delete on conetl.watched_drive, conetl.provisional_feature to conetl_writer;
revoke insert on conetl.schema_migration from conetl_writer;
do $$
begin
    execute format('grant temporary on database %I to conetl_writer', current_database());
end
$$;
