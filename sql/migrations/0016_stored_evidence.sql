-- Evidence is stored, not computed from deltas in each query: how many drives saw and missed a feature, and the existence
-- probability after the last of them, are columns of its versions. A drive that misses a feature and leaves it on the map begins a new
-- row of the same version. Views and functions stand in sql/functions/ from now on, as they are; those that end, or return other
-- columns there, are dropped here.

drop schema conetl_ogc cascade;
drop function conetl.feature_evidence, conetl.map_as_of, conetl.marking_json;
drop view conetl.current_feature, conetl.sighting_evidence;
drop view conetl.on_hold, conetl.newer_delivery, conetl.active_drive;

create table conetl.schema_functions (
    sha256     text not null,
    applied_at timestamptz not null default clock_timestamp()
);
comment on table conetl.schema_functions is 'From which files of sql/functions/ the views and functions were made, newest last.';

-- The order in which drives are compared with the map.
alter table conetl.drive alter column content_sha256 type text collate "C";
alter table conetl.changeset alter column idempotency_key type text collate "C";
create type conetl.drive_order as (
    captured_from_ns bigint, content_sha256 text collate "C", idempotency_key text collate "C"
);
comment on type conetl.drive_order is 'Drives are compared with the map in this order, whatever the order in which they came.';

-- One name for the height of an object, other than that of the ground below it.
alter table conetl.feature_version rename column cone_height_m to object_height_m;
alter table conetl.feature_version rename column cone_height_sigma_m to object_height_sigma_m;
alter table conetl.track rename column cone_height_m to object_height_m;
alter table conetl.track rename column cone_height_sigma_m to object_height_sigma_m;
alter table conetl.statement rename column cone_height_m to object_height_m;
alter table conetl.statement rename column cone_height_sigma_m to object_height_sigma_m;
alter table conetl.position rename column cone_height_m to object_height_m;
alter table conetl.provisional_feature rename column cone_height_m to object_height_m;

alter table conetl.feature_version
    add column seen_count      integer,
    add column missed_count    integer,
    add column first_missed_ns bigint;
drop index conetl.feature_version_current;
alter table conetl.feature_version disable trigger user;

-- All that was ever known of each feature, numbered in the order of the drives.
create temporary table judgement on commit drop as
select
    x.cell, x.feature_id, x.changeset_id, x.kind, x.old_version, x.new_version, x.changed_at_ns, x.changed_at, x.existence_after,
    x.system_period, x.kind in ('missed', 'removed') as misses,
    d.kind = 'drive' and x.kind not in ('missed', 'removed', 'merged') as sees,
    dense_rank() over (
        partition by x.feature_id order by d.captured_from_ns, d.content_sha256, c.idempotency_key
    ) as number
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid);
create index on judgement (feature_id);
analyze judgement;

-- For each version and each span of system time in which nothing was learnt about its feature: the drives until then that judged the feature,
-- and the misses of this version, each with the span of time on the road in which it is the last one.
create temporary table stated on commit drop as
with span as (
    select
        v.version_row_id, v.feature_id, v.version, v.changeset_id, v.valid_from_ns, v.valid_period,
        tstzrange(t.at, lead(t.at, 1, upper(v.system_period)) over (partition by v.version_row_id order by t.at)) as system_period
    from conetl.feature_version v
    cross join lateral (
        select lower(v.system_period) as at
        union
        select e.at
        from judgement j
        cross join lateral (values (lower(j.system_period)), (upper(j.system_period))) e (at)
        where j.feature_id = v.feature_id
        and e.at > lower(v.system_period) and e.at < coalesce(upper(v.system_period), 'infinity')
    ) t
),
founded as (  -- the state as its own drive left it
    select
        s.*, own.number, n.seen_count, n.missed_count,
        coalesce(own.existence_after, case own.kind when 'merged' then n.existence_before end) as existence_probability
    from span s
    left join lateral (
        select j.number, j.kind, j.existence_after from judgement j
        where j.feature_id = s.feature_id and j.changeset_id = s.changeset_id and j.system_period @> lower(s.system_period)
        limit 1
    ) own on true
    cross join lateral (
        select
            count(*) filter (where j.sees)::integer as seen_count, count(*) filter (where j.misses)::integer as missed_count,
            (array_agg(j.existence_after order by j.number desc) filter (where j.existence_after is not null))[1] as existence_before
        from judgement j
        where j.feature_id = s.feature_id and j.system_period @> lower(s.system_period) and j.number <= own.number
    ) n
),
missed as (
    select
        f.version_row_id, f.system_period, j.changeset_id, j.number, f.seen_count,
        f.missed_count + row_number() over w as missed_count, j.existence_after as existence_probability,
        min(j.changed_at_ns) over (partition by f.version_row_id, f.system_period order by j.number) as first_missed_ns,
        greatest(j.changed_at_ns, f.valid_from_ns + 1000) as valid_from_ns
    from founded f
    join judgement j on j.feature_id = f.feature_id and j.old_version = f.version and j.kind = 'missed'
        and j.system_period @> lower(f.system_period)
    window w as (partition by f.version_row_id, f.system_period order by j.number)
),
every as (
    select version_row_id, system_period, changeset_id, number, seen_count, missed_count, existence_probability,
        null::bigint as first_missed_ns, valid_from_ns
    from founded
    union all
    -- A miss that a later drive precedes on the road is part of that one.
    select m.version_row_id, m.system_period, m.changeset_id, m.number, m.seen_count, m.missed_count, m.existence_probability,
        m.first_missed_ns, m.valid_from_ns
    from missed m
    where not exists (
        select from missed l
        where l.version_row_id = m.version_row_id and l.system_period = m.system_period and l.number > m.number
        and l.valid_from_ns / 1000 <= m.valid_from_ns / 1000
    )
),
timed as (
    select
        e.*, v.valid_period as version_period,
        case when e.first_missed_ns is null then lower(v.valid_period)
            else timestamptz 'epoch' + e.valid_from_ns / 1000 * interval '1 microsecond' end as valid_from
    from every e
    join conetl.feature_version v using (version_row_id)
)
select
    t.*,
    tstzrange(
        t.valid_from,
        lead(t.valid_from, 1, upper(t.version_period)) over (partition by t.version_row_id, t.system_period order by t.valid_from)
    ) as valid_period
from timed t
where t.first_missed_ns is null or t.valid_from < coalesce(upper(t.version_period), 'infinity');

-- Successive spans of system time in which a row is the same are one.
create temporary table evidence on commit drop as
select
    version_row_id, changeset_id, seen_count, missed_count, existence_probability, first_missed_ns, valid_from_ns, valid_period,
    tstzrange(min(lower(system_period)), nullif(max(coalesce(upper(system_period), 'infinity')), 'infinity')) as system_period
from (
    select
        s.*,
        count(*) filter (where begins) over (
            partition by version_row_id, changeset_id, seen_count, missed_count, existence_probability, first_missed_ns, valid_from_ns,
                valid_period
            order by lower(system_period)
        ) as island
    from (
        select
            s.*,
            lower(s.system_period) is distinct from lag(upper(s.system_period)) over (
                partition by version_row_id, changeset_id, seen_count, missed_count, existence_probability, first_missed_ns,
                    valid_from_ns, valid_period
                order by lower(s.system_period)
            ) as begins
        from stated s
    ) s
) s
group by
    version_row_id, changeset_id, seen_count, missed_count, existence_probability, first_missed_ns, valid_from_ns, valid_period, island;

-- The first row of a version takes its place, so that rows without misses keep their number.
create temporary table placed on commit drop as
select e.*, row_number() over (partition by version_row_id order by lower(system_period), valid_from_ns) = 1 as is_first from evidence e;
create index on placed (version_row_id);
analyze placed;
do $$
declare
    copied text;
begin
    select string_agg(quote_ident(attname), ', ') into copied
    from pg_attribute
    where attrelid = 'conetl.feature_version'::regclass and attnum > 0 and not attisdropped
    and attname not in (
        'version_row_id', 'changeset_id', 'seen_count', 'missed_count', 'existence_probability', 'first_missed_ns', 'valid_from_ns',
        'valid_period', 'system_period'
    );
    execute format(
        'insert into conetl.feature_version (%1$s, changeset_id, seen_count, missed_count, existence_probability, first_missed_ns, '
        'valid_from_ns, valid_period, system_period) '
        'select %2$s, p.changeset_id, p.seen_count, p.missed_count, coalesce(p.existence_probability, v.existence_probability), '
        'p.first_missed_ns, p.valid_from_ns, p.valid_period, p.system_period '
        'from placed p join conetl.feature_version v using (version_row_id) where not p.is_first',
        copied, 'v.' || replace(copied, ', ', ', v.')
    );
end
$$;
update conetl.feature_version v
set seen_count = p.seen_count, missed_count = p.missed_count, first_missed_ns = p.first_missed_ns,
    existence_probability = coalesce(p.existence_probability, v.existence_probability),
    changeset_id = p.changeset_id, valid_from_ns = p.valid_from_ns, valid_period = p.valid_period, system_period = p.system_period
from placed p
where p.version_row_id = v.version_row_id and p.is_first;

alter table conetl.feature_version enable trigger user;
alter table conetl.feature_version
    alter column seen_count set not null,
    alter column missed_count set not null,
    add check (seen_count >= 0 and missed_count >= 0),
    add constraint missed_features_stand check (first_missed_ns is null or present or suppressed);
create unique index feature_version_current
    on conetl.feature_version (cell, feature_id, lower(valid_period), coalesce(upper(system_period), 'infinity'));
comment on column conetl.feature_version.existence_probability is
    'After the last drive to which it was visible; of a removed feature, after the drive that removed it.';
comment on column conetl.feature_version.seen_count is 'Drives that observed it until then; imported maps do not count.';
comment on column conetl.feature_version.missed_count is 'Drives to which it was visible until then and that did not observe it.';
comment on column conetl.feature_version.first_missed_ns is
    'When the first of the drives that missed it since its last observation did (UTC ns); null: none did. Other rows of a version are by '
    'the drive that changed it.';

-- docs/reference/database.md is made from the comments.
comment on table conetl.map is 'One map: name, CRS, height system, licence.';
comment on table conetl.drive is
    'One ingested state of a recording (the same drive_id with other content or parameters is another row), or one imported map.';
comment on table conetl.frame_pair is 'The frame pairs of a drive: images, instant, pose of the body with its sigmas.';
comment on table conetl.detection is 'Boxes that the detector found in the rectified images of a drive.';
comment on table conetl.stereo_match is 'Pairs of a left and a right detection that show one object, with the image points that were measured.';
comment on table conetl.position is 'Positions by collinearity, one per stereo match, with their covariances.';
comment on table conetl.track is 'The objects that a drive observed, with their covariances: what is compared with the map.';
comment on table conetl.marking_track is 'The lane markings that a drive observed, or parts of them: what is compared with the map.';
comment on table conetl.changeset is 'What one drive or imported map did to the map, with hashes of parameters, model and code, and counts.';
comment on table conetl.quarantine is 'Rejected records, with their reason and content.';
comment on table conetl.feature is 'One row per object that was ever on a map; its id never changes.';
comment on table conetl.feature_version is
    'The states of a feature and of the evidence for it, by valid and system period. A change closes the open row in system time and '
    'writes two new ones: the same state with the end of its valid period, and the new state. Nothing is overwritten.';
comment on table conetl.delta is 'What a drive did to a feature or observed of it, one per feature and drive.';
comment on table conetl.decision is 'What people decided: suppress, pin, classify, revert, accept, withdraw. Append-only.';
comment on table conetl.hold is 'Why a drive is, or was, on hold.';
comment on table conetl.schema_migration is 'The migrations of this database.';
