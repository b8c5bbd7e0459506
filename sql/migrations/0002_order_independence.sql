-- Purpose: the map as a pure function of the drives and decisions that went in, whatever the order in which they came.
--
-- A drive keeps what is needed to compare it with the map again: its parameters of comparison, and how far around its path it
-- changes or judges anything. Deltas get a system period like versions: a drive that comes late changes what later drives did.
-- What a person decides is a row of its own; it takes part in every later comparison. Units as in 0001.

alter table conetl.drive add column reconcile jsonb;
alter table conetl.drive add column influence_m float8 check (influence_m > 0);
alter table conetl.drive add column area geometry(Geometry);  -- covers everything within influence_m of the path
update conetl.drive d
set reconcile = coalesce(
        (
            select r.params -> 'reconcile'
            from conetl.changeset c
            join conetl.run r using (run_id)
            where c.drive_uuid = d.drive_uuid
            limit 1
        ),
        '{}'
    ),
    influence_m = 60,
    area = (
        select ST_Buffer(ST_Force2D(ST_MakeLine(p.geom order by p.frame_index)), 70)
        from (
            select f.geom, f.frame_index from conetl.frame_pair f where f.drive_uuid = d.drive_uuid
            union all
            -- A line needs two points.
            (
                select ST_Translate(f.geom, 0.1, 0), f.frame_index + 1
                from conetl.frame_pair f
                where f.drive_uuid = d.drive_uuid
                order by f.frame_index desc
                limit 1
            )
        ) p
    );
alter table conetl.drive alter column reconcile set not null;
alter table conetl.drive alter column influence_m set not null;
alter table conetl.drive alter column area set not null;
create index drive_by_area on conetl.drive using gist (area);
create index drive_by_content on conetl.drive (map_id, content_sha256);
comment on column conetl.drive.reconcile is 'Parameters with which the drive is compared with the map, also when it is played again.';

create index changeset_by_drive on conetl.changeset (drive_uuid);

drop function conetl.map_as_of(text, timestamptz, timestamptz);
drop view conetl.current_feature;
-- A person said that nothing stands here: the version goes on in the comparison of drives, but is not on the map.
alter table conetl.feature_version add column suppressed boolean not null default false;
alter table conetl.feature_version add constraint suppressed_is_not_present check (not (suppressed and present));

alter table conetl.delta add column delta_row_id bigint generated always as identity;
alter table conetl.delta add column system_period tstzrange;
update conetl.delta x
set system_period = tstzrange((select c.committed_at from conetl.changeset c where c.changeset_id = x.changeset_id), null);
alter table conetl.delta alter column system_period set not null;
alter table conetl.delta drop constraint delta_pkey;
alter table conetl.delta add primary key (delta_row_id);
alter table conetl.delta add check (
    not isempty(system_period) and lower_inc(system_period) and not upper_inc(system_period)
);
create unique index delta_believed on conetl.delta (changeset_id, feature_id) where upper_inf(system_period);
comment on column conetl.delta.system_period is
    'When the database held this for what the drive did; an earlier drive that comes later ends it and writes another.';

-- Append-only. Suppress: nothing stands within radius_m of geom, whatever drives see. Pin: a cone within radius_m of geom is
-- neither removed nor moved by drives. Revert: the changeset's drive does not count. Withdraw: the decision it names is no more.
create table conetl.decision (
    decision_id  uuid primary key,
    decision_no  bigint generated always as identity unique,
    map_id       integer not null,
    srid         integer not null,
    kind         text not null check (kind in ('suppress', 'pin', 'revert', 'withdraw')),
    geom         geometry(Point),
    radius_m     float8 check (radius_m > 0 and radius_m < 'infinity'),
    feature_id   uuid,     -- that the person pointed at; no foreign key: a later fold may do without it
    changeset_id uuid references conetl.changeset,
    withdraws    uuid unique references conetl.decision,
    note         text not null,
    decided_at   timestamptz not null,  -- system time
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    check ((kind in ('suppress', 'pin')) = (geom is not null and radius_m is not null)),
    check (geom is null or ST_SRID(geom) = srid),
    check ((kind = 'revert') = (changeset_id is not null)),
    check ((kind = 'withdraw') = (withdraws is not null))
);
create index decision_by_map on conetl.decision (map_id, decided_at);

create view conetl.active_decision as
select d.*
from conetl.decision d
where d.kind <> 'withdraw' and not exists (select from conetl.decision w where w.withdraws = d.decision_id);
comment on view conetl.active_decision is 'What people decided and did not take back.';

create view conetl.active_drive as
select d.*, c.changeset_id, c.changeset_no, c.idempotency_key
from conetl.changeset c
join conetl.drive d using (drive_uuid)
where not exists (select from conetl.active_decision r where r.changeset_id = c.changeset_id)
and not exists (
    select
    from conetl.drive other
    join conetl.changeset newer on newer.drive_uuid = other.drive_uuid
    where other.map_id = d.map_id and other.content_sha256 = d.content_sha256 and newer.changeset_no > c.changeset_no
    and not exists (select from conetl.active_decision r where r.changeset_id = newer.changeset_id)
);
comment on view conetl.active_drive is
    'The drives that make the map: not reverted, and of each recording the analysis that was ingested last.';

create view conetl.current_feature as
select m.map_name, v.*
from conetl.feature_version v
join conetl.map m using (map_id)
where upper_inf(v.system_period) and upper_inf(v.valid_period) and v.present;
comment on view conetl.current_feature is 'The map as it is now, as the database knows it now; one row per standing cone.';

create function conetl.map_as_of(map_name text, valid_at timestamptz, known_at timestamptz default 'infinity')
returns setof conetl.current_feature
language sql stable
as $$
    select m.map_name, v.*
    from conetl.feature_version v
    join conetl.map m using (map_id)
    where m.map_name = $1 and v.present and v.valid_period @> $2 and v.system_period @> $3
$$;
comment on function conetl.map_as_of is
    'The map of the instant valid_at as the database knew it at known_at; infinity means latest.';
