-- Purpose: the table that remembers which migrations were applied. Run before every migration; harmless when it is there.
create schema if not exists conetl;
create table if not exists conetl.schema_migration (
    name       text primary key,
    sha256     text not null,
    applied_at timestamptz not null default clock_timestamp()
);
