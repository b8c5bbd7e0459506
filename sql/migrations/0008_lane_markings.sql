-- Lane markings: lines with a covariance per vertex. A feature that is a line has its shape beside geom, which is its middle vertex.

alter table conetl.feature_version
    add column line              geometry(LineStringZ),
    add column line_cov          float8[],           -- line_cov[vertex][xx, xy, xz, yy, yz, zz], m^2
    add column width_m           float8 check (width_m > 0),
    add column width_sigma_m     float8 check (width_sigma_m > 0),
    add column colour            text,
    add column pattern           text,
    add column dash_m            float8 check (dash_m > 0),
    add column gap_m             float8 check (gap_m > 0),
    add constraint line_has_all_columns check (
        num_nulls(line, line_cov, width_m, width_sigma_m, colour, pattern) in (0, 6)
        and (line is null or ST_SRID(line) = srid)
        and (dash_m is null) = (gap_m is null)
    );
comment on column conetl.feature_version.line is
    'Centre line of a lane marking, or of a stretch of one; null of point objects.';
comment on column conetl.feature_version.line_cov is
    'Covariance of each vertex: line_cov[vertex] is xx, xy, xz, yy, yz, zz in m^2.';

create or replace view conetl.current_feature as
select m.map_name, v.*
from conetl.feature_version v
join conetl.map m using (map_id)
where upper_inf(v.system_period) and upper_inf(v.valid_period) and v.present;

create table conetl.marking_track (
    drive_uuid            uuid not null references conetl.drive,
    marking_index         integer not null,
    category              text not null,
    line                  geometry(LineStringZ) not null,
    line_cov              float8[] not null,
    relative_cov          float8[] not null,          -- without the errors that all vertices share
    width_m               float8 not null check (width_m > 0),
    width_sigma_m         float8 not null check (width_sigma_m > 0),
    colour                text not null,
    pattern               text not null,
    dash_m                float8 check (dash_m > 0),
    gap_m                 float8 check (gap_m > 0),
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count > 0),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null,
    contrast              float8 not null,
    blur_px               float8 not null check (blur_px >= 0),
    calibrations          uuid[],
    shared_jacobian_m     real[],
    primary key (drive_uuid, marking_index)
);
comment on table conetl.marking_track is 'The lane markings that a drive observed: what the fold of the map compares.';

-- The counts of changes are those of point objects; lines have their own.
alter table conetl.delta add column of_line boolean not null default false;
alter table conetl.delta alter column of_line drop default;
comment on column conetl.delta.of_line is 'Whether the feature is a line.';

alter table conetl.changeset add column line_counts jsonb not null default '{}';
comment on column conetl.changeset.line_counts is 'Number of changes of stretches of lane markings by kind, as committed; the other counts are of point objects.';
alter table conetl.changeset add column marking_count integer not null default 0;
alter table conetl.changeset alter column marking_count drop default;

-- A cone often stands on a lane marking: a decision about one of them is none about the other.
alter table conetl.decision add column of_line boolean not null default false;
comment on column conetl.decision.of_line is 'Of suppress and pin: whether it is about lines; else about point objects.';
create or replace view conetl.active_decision as
select d.*
from conetl.decision d
where d.kind <> 'withdraw' and not exists (select from conetl.decision w where w.withdraws = d.decision_id);

-- Lane markings for other programs -----------------------------------------------------------------------------------------------

create index feature_version_of_line on conetl.feature_version using gist (line) where line is not null;

create function conetl.lateral_sigma_m(line geometry, line_cov float8[]) returns float8
language sql immutable strict
as $$
    select sqrt(max(
        ((b.y - a.y) ^ 2 * line_cov[n.i][1] - 2 * (b.y - a.y) * (b.x - a.x) * line_cov[n.i][2] + (b.x - a.x) ^ 2 * line_cov[n.i][4])
        / ((b.x - a.x) ^ 2 + (b.y - a.y) ^ 2)
    ))
    from generate_series(1, ST_NPoints(line)) n (i)
    cross join lateral (select ST_PointN(line, greatest(n.i - 1, 1)) as p) before
    cross join lateral (select ST_PointN(line, least(n.i + 1, ST_NPoints(line))) as p) after
    cross join lateral (select ST_X(before.p) as x, ST_Y(before.p) as y) a
    cross join lateral (select ST_X(after.p) as x, ST_Y(after.p) as y) b
    where (b.x, b.y) <> (a.x, a.y)
$$;
comment on function conetl.lateral_sigma_m is
    'Largest standard deviation across a line (m): of the vertex with the largest one, at right angles to the line there.';

create function conetl.marking_json(
    line geometry, line_cov float8[], width_m float8, width_sigma_m float8, colour text, pattern text, dash_m float8, gap_m float8
) returns json
language sql immutable
as $$
    select case when line is not null then json_build_object(
        'line_m', (ST_AsGeoJSON(line, 4)::json) -> 'coordinates', 'width_m', width_m, 'width_sigma_m', width_sigma_m,
        'colour', colour, 'pattern', pattern, 'dash_m', dash_m, 'gap_m', gap_m,
        'sigma_lateral_m', conetl.lateral_sigma_m(line, line_cov)
    ) end
$$;
comment on function conetl.marking_json is 'The shape of a lane marking for the web view; null of point objects. line_m is in the map''s CRS.';

-- The collections of points list no lines.
do $$
declare
    old record;
    body text;
begin
    for old in
        select pg_get_functiondef(p.oid) as definition
        from pg_proc p
        where p.pronamespace = 'conetl_ogc'::regnamespace and p.proname in ('standing', 'changes')
    loop
        body = regexp_replace(old.definition, 'm\.map_name = \$1 and ([abv])\.present', 'm.map_name = $1 and \1.line is null and \1.present', 'g');
        if body = old.definition then
            raise exception 'unknown definition of a function of conetl_ogc';
        end if;
        execute body;
    end loop;
end
$$;

-- Like conetl_ogc.features, for lines. A line is in a box that it touches.
create function conetl_ogc.lane_markings(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30
)
returns table (
    feature_id uuid, version integer, category text, existence_probability float8,
    width_m float8, width_sigma_m float8, colour text, pattern text, dash_m float8, gap_m float8,
    length_m float8, sigma_lateral_m float8, observation_count integer, seen_count integer, missed_count integer,
    first_seen_at timestamptz, last_seen_at timestamptz, valid_from timestamptz, valid_to timestamptz,
    geom geometry
)
language sql stable
as $$
    select
        v.feature_id, v.version, v.category,
        coalesce(
            (select e.existence_after from conetl.feature_evidence(v.feature_id, v.version, (select $3), (select $4)) e),
            v.existence_probability
        ),
        v.width_m, v.width_sigma_m, v.colour, v.pattern, v.dash_m, v.gap_m,
        ST_3DLength(v.line), conetl.lateral_sigma_m(v.line, v.line_cov), v.observation_count,
        (select e.seen_count from conetl.feature_evidence(v.feature_id, v.version, (select $3), (select $4)) e),
        (select e.missed_count from conetl.feature_evidence(v.feature_id, v.version, (select $3), (select $4)) e),
        timestamptz 'epoch' + v.first_seen_ns / 1000 * interval '1 microsecond',
        timestamptz 'epoch' + v.last_seen_ns / 1000 * interval '1 microsecond',
        lower(v.valid_period), upper(v.valid_period),
        ST_Transform(v.line, 4326)
    from conetl.map m
    join conetl.feature_version v using (map_id)
    where m.map_name = $1 and v.line is not null and v.present
    and v.valid_period && (select tstzrange($2, $3, '[]')) and v.system_period @> (select $4)
    and (
        (select $2 = $3) or not exists (
            select from conetl.feature_version later
            where later.cell = v.cell and later.feature_id = v.feature_id and later.present
            and later.valid_period && (select tstzrange($2, $3, '[]'))
            and later.system_period @> (select $4) and lower(later.valid_period) > lower(v.valid_period)
        )
    )
    and v.line && ST_MakeEnvelope($9, $10, $11, $12)
    and (
        ($5 <= -180 and $6 <= -90 and $7 >= 180 and $8 >= 90)
        or ST_Intersects(
            ST_Transform(v.line, 4326),
            case
                when $5 <= $7 then ST_MakeEnvelope($5 - 5e-10, $6 - 5e-10, $7 + 5e-10, $8 + 5e-10, 4326)
                else ST_Collect(
                    ST_MakeEnvelope($5 - 5e-10, $6 - 5e-10, 180, $8 + 5e-10, 4326),
                    ST_MakeEnvelope(-180, $6 - 5e-10, $7 + 5e-10, $8 + 5e-10, 4326)
                )
            end
        )
    )
$$;
comment on function conetl_ogc.lane_markings is
    'The lane markings of a map that stood between two instants on the road, as the database knew it.';
