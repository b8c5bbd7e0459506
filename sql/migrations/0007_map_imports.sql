-- Purpose: maps of others as a beginning, and the licence that goes with a map.
--
-- An import is one more event of the fold: a row in conetl.drive (kind 'import') with its own time and the hash of the file, and what the
-- file states in a table of its own. It has no rig, no frame pairs and no tracks. Units as in 0001.

alter table conetl.map add column licence text;
comment on column conetl.map.licence is 'Licence of the map''s data, as it is handed out with every export; null: none was set.';

alter table conetl.drive add column kind text not null default 'drive' check (kind in ('drive', 'import'));
alter table conetl.drive alter column rig drop not null;
alter table conetl.drive drop constraint drive_expected_frame_count_check;
alter table conetl.drive add check (
    case kind when 'drive' then rig is not null and expected_frame_count > 0 else rig is null and expected_frame_count = 0 end
);
comment on column conetl.drive.kind is 'import: not a recording, but a map that was made elsewhere, with the time for which it speaks.';

create table conetl.statement (
    drive_uuid            uuid not null references conetl.drive,
    statement_index       integer not null check (statement_index >= 0),
    feature_id            uuid not null,  -- as the file names it; a feature that the fold finds at the place keeps its own
    category              text not null,
    geom                  geometry(PointZ) not null,
    cov_xx                float8 not null,
    cov_xy                float8 not null,
    cov_xz                float8 not null,
    cov_yy                float8 not null,
    cov_yz                float8 not null,
    cov_zz                float8 not null,
    cone_height_m         float8 not null check (cone_height_m > 0 and cone_height_m < 'infinity'),
    cone_height_sigma_m   float8 not null check (cone_height_sigma_m > 0 and cone_height_sigma_m < 'infinity'),
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count >= 1),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null,
    valid_from_ns         bigint not null,
    primary key (drive_uuid, statement_index),
    unique (drive_uuid, feature_id),
    check (cov_xx > 0 and cov_yy > 0 and cov_zz > 0),
    check (first_seen_ns <= last_seen_ns)
);
comment on table conetl.statement is 'What an imported map says: here stands a cone.';

-- An imported map is no drive that saw anything: its rows in conetl.sighting_evidence have frames_seen 0, and the counts leave it out.
create or replace function conetl.feature_evidence(
    feature_id uuid, version integer, valid_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    out seen_count integer, out missed_count integer, out existence_after float8
)
language sql stable
as $$
    select
        count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive')::integer,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer,
        (
            array_agg(
                x.existence_after
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            ) filter (where x.kind = 'missed' and x.old_version = $2)
        )[1]
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where x.feature_id = $1 and x.changed_at <= $3 and x.system_period @> $4
$$;
