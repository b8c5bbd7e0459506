-- Plans of work zones (permits, closures of a feed) with their history, to be compared with the zones of a map; and what people say
-- about a difference. It is no decision: it changes nothing on the map, so no drive is compared again because of it.

create table conetl.plan (
    plan_row_id   bigint generated always as identity primary key,
    map_id        integer not null,
    srid          integer not null,
    list_name     text not null check (list_name <> ''),
    plan_id       text not null check (plan_id <> ''),
    record        jsonb not null,
    geom          geometry not null,
    file_name     text not null,
    system_period tstzrange not null check (not isempty(system_period)),
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    check (srid = ST_SRID(geom)),
    constraint one_version exclude using gist (map_id with =, list_name with =, plan_id with =, system_period with &&)
);
create index plan_geom on conetl.plan using gist (geom);
comment on table conetl.plan is 'Versions of plans of work zones; a changed plan ends its older version in system time.';
comment on column conetl.plan.list_name is 'Of whom the plan is: ids of plans are unique in a list.';
comment on column conetl.plan.record is 'What the source states, as PlannedZone (model/planned_zones.py), in WGS 84.';
comment on column conetl.plan.geom is 'Its place in the map''s CRS.';

create table conetl.plan_verdict (
    verdict_no bigint generated always as identity primary key,
    map_id     integer not null references conetl.map,
    difference jsonb not null,
    verdict    text not null check (verdict in ('confirmed', 'accepted', 'wrong', 'open')),
    note       text not null,
    decided_by text check (decided_by <> ''),
    decided_at timestamptz not null
);
create index plan_verdict_by_map on conetl.plan_verdict (map_id, verdict_no);
comment on table conetl.plan_verdict is
    'What people say about differences between plans and the map; the last one of a difference counts. It is known again by its kind, '
    'plan, place and time, not by the id of a zone, which a late drive may change.';
comment on column conetl.plan_verdict.difference is 'As it was then, as Difference (model/planned_zones.py).';
