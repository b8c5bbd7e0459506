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
