-- Purpose: what a report of a drive needs beyond its records, and features that a drive shows while it is still being recorded.
--
-- run.facts: sentences and versions that no other table holds: trajectory, calibration, code_sha256, python, libraries.
-- run_step: how long each step of a run took; written after the commit, so it may be missing.
-- Provisional features are no part of the map: no version, delta, audit or export knows them. They are replaced while the drive is
-- watched and go when it is ingested, so unlike all else here they are changed and deleted. Units as in 0001.

alter table conetl.run add column facts jsonb;
comment on column conetl.run.facts is 'What became of trajectory and calibration, in words, and what code did it; null: not kept.';

create table conetl.run_step (
    run_id     uuid not null references conetl.run,
    step       text not null,
    task_count integer not null check (task_count > 0),
    busy_s     float8 not null check (busy_s >= 0),   -- summed over its tasks, which may run beside each other
    started_s  float8 not null,                       -- since the run's first step began
    ended_s    float8 not null check (ended_s >= started_s),
    primary key (run_id, step)
);
comment on table conetl.run_step is 'How long each step of a run took, by the clock.';

-- No foreign key to conetl.map: the first ingest makes a map, watching never does.
create table conetl.watched_drive (
    watch_id         uuid primary key,
    map_name         text not null check (map_name ~ '^[a-z0-9_-]{1,40}$'),
    srid             integer not null check (srid > 0),
    drive_id         text not null,
    source_path      text not null,
    started_at       timestamptz not null default clock_timestamp(),
    ended_at         timestamptz,              -- null: being watched, or its watcher died
    captured_from_ns bigint not null,          -- of the frame pairs taken so far
    captured_to_ns   bigint not null check (captured_to_ns >= captured_from_ns),
    frame_pair_count integer not null check (frame_pair_count > 0),
    updated_at       timestamptz not null default clock_timestamp()
);
create index watched_drive_by_name on conetl.watched_drive (map_name, drive_id);
comment on table conetl.watched_drive is 'A drive that is watched while it is recorded, or was and is not ingested yet.';

create table conetl.provisional_feature (
    watch_id              uuid not null references conetl.watched_drive on delete cascade,
    feature_index         integer not null check (feature_index >= 0),
    srid                  integer not null,
    geom                  geometry(PointZ) not null,  -- foot centre on the ground
    cov_xx                float8 not null,
    cov_xy                float8 not null,
    cov_xz                float8 not null,
    cov_yy                float8 not null,
    cov_yz                float8 not null,
    cov_zz                float8 not null,
    cone_height_m         float8 not null check (cone_height_m > 0 and cone_height_m < 'infinity'),
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count >= 1),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null check (last_seen_ns >= first_seen_ns),
    near_feature_id       uuid,                       -- the standing feature that it may be; null: none near
    updated_at            timestamptz not null default clock_timestamp(),
    primary key (watch_id, feature_index),
    check (ST_SRID(geom) = srid),
    check (cov_xx > 0 and cov_yy > 0 and cov_zz > 0)
);
comment on table conetl.provisional_feature is
    'What a drive shows while it is recorded, from logged poses; the ingest of the drive replaces it by the map itself.';
