-- Purpose: the map with its full history, the drives it was made from, and what was refused.
--
-- Units: metres, m^2 (covariances), pixels of the original image, radians; *_ns are UTC nanoseconds since 1970 (exact),
-- timestamptz columns beside them are the same instant cut to microseconds (for queries). Points are easting, northing of
-- the map's CRS and ellipsoidal height. Covariances are the upper triangle xx, xy, xz, yy, yz, zz.
--
-- The CRS is a property of the map (one database may hold several maps), so the geometry columns are typed PointZ without an
-- SRID; the map's SRID is enforced by foreign keys that carry it down (map -> feature -> feature_version) and a check.

create extension if not exists postgis with schema public;
create extension if not exists btree_gist with schema public;
create schema if not exists conetl;

create table conetl.map (
    map_id     integer generated always as identity primary key,
    map_name   text not null unique check (map_name ~ '^[a-z0-9_-]{1,40}$'),
    srid       integer not null check (srid > 0),
    created_at timestamptz not null,
    unique (map_id, srid)
);

create table conetl.run (
    run_id        uuid primary key,
    started_at    timestamptz not null,
    finished_at   timestamptz not null,
    params        jsonb not null,
    flow_run_id   text
);
comment on table conetl.run is 'One run of the pipeline that ended in a changeset, with the parameters in full.';

create table conetl.drive (
    drive_uuid           uuid primary key,
    map_id               integer not null,
    srid                 integer not null,
    drive_id             text not null,
    source_path          text not null,
    content_sha256       text not null check (content_sha256 ~ '^[0-9a-f]{64}$'),
    rig                  jsonb not null,
    captured_from_ns     bigint not null,
    captured_to_ns       bigint not null,
    captured_period      tstzrange not null,
    expected_frame_count integer not null check (expected_frame_count > 0),
    foreign key (map_id, srid) references conetl.map (map_id, srid)
);
create index drive_by_name on conetl.drive (map_id, drive_id);
comment on table conetl.drive is
    'One ingested state of a recording: the same drive_id with other content or parameters is another row.';

-- Raw records of a drive. They are loaded by COPY, millions at a time, and checked in memory before; a foreign key per row
-- would double the load time, so that they belong together is checked by an audit instead.
create table conetl.frame_pair (
    drive_uuid     uuid not null,
    frame_index    integer not null,
    left_path      text not null,
    right_path     text not null,
    captured_at_ns bigint not null,
    geom           geometry(PointZ) not null,   -- of the body (INS unit)
    map_r_body     float8[] not null,           -- 9 values, row by row
    sigma_enu_m    float8[] not null,
    sigma_rpy_rad  float8[] not null,
    primary key (drive_uuid, frame_index)
);

create table conetl.detection (
    drive_uuid      uuid not null,
    frame_index     integer not null,
    side            text not null check (side in ('left', 'right')),
    detection_index integer not null,
    category        text not null,
    x_px            float8 not null,
    y_px            float8 not null,
    w_px            float8 not null,
    h_px            float8 not null,
    score           float8 not null check (score between 0 and 1),
    primary key (drive_uuid, frame_index, side, detection_index)
);

create table conetl.stereo_match (
    drive_uuid            uuid not null,
    frame_index           integer not null,
    match_index           integer not null,
    left_detection_index  integer not null,
    right_detection_index integer not null,
    foot_left_u_px        float8 not null,
    foot_left_v_px        float8 not null,
    foot_right_u_px       float8 not null,
    foot_right_v_px       float8 not null,
    centre_left_u_px      float8 not null,
    centre_left_v_px      float8 not null,
    centre_right_u_px     float8 not null,
    centre_right_v_px     float8 not null,
    tip_left_u_px         float8 not null,
    tip_left_v_px         float8 not null,
    tip_right_u_px        float8 not null,
    tip_right_v_px        float8 not null,
    sigma_u_px            float8 not null,
    sigma_v_px            float8 not null,
    sigma_pointing_px     float8 not null,
    refined               boolean not null,
    cost                  float8 not null,
    primary key (drive_uuid, frame_index, match_index)
);

create table conetl.position (
    drive_uuid       uuid not null,
    frame_index      integer not null,
    match_index      integer not null,
    geom             geometry(PointZ) not null,  -- foot centre
    cov_xx           float8 not null,
    cov_xy           float8 not null,
    cov_xz           float8 not null,
    cov_yy           float8 not null,
    cov_yz           float8 not null,
    cov_zz           float8 not null,
    centre_geom      geometry(PointZ) not null,  -- box centre
    cone_height_m    float8 not null,
    camera_x_m       float8 not null,            -- foot in the left camera's frame
    camera_y_m       float8 not null,
    camera_z_m       float8 not null,
    camera_cov_xx    float8 not null,
    camera_cov_xy    float8 not null,
    camera_cov_xz    float8 not null,
    camera_cov_yy    float8 not null,
    camera_cov_yz    float8 not null,
    camera_cov_zz    float8 not null,
    range_m          float8 not null,
    ray_angle_rad    float8 not null,
    residual_rms_px  float8 not null,
    iterations       integer not null,
    score            float8 not null,
    primary key (drive_uuid, frame_index, match_index)
);

create table conetl.track (
    drive_uuid            uuid not null references conetl.drive,
    track_index           integer not null,
    category              text not null,
    geom                  geometry(PointZ) not null,
    cov_xx                float8 not null,
    cov_xy                float8 not null,
    cov_xz                float8 not null,
    cov_yy                float8 not null,
    cov_yz                float8 not null,
    cov_zz                float8 not null,
    relative_cov_xx       float8 not null,
    relative_cov_xy       float8 not null,
    relative_cov_xz       float8 not null,
    relative_cov_yy       float8 not null,
    relative_cov_yz       float8 not null,
    relative_cov_zz       float8 not null,
    centre_geom           geometry(PointZ) not null,
    cone_height_m         float8 not null,
    cone_height_sigma_m   float8 not null,
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count > 0),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null,
    residual_rms_px       float8 not null,
    nearest_range_m       float8 not null,
    primary key (drive_uuid, track_index)
);

create table conetl.track_member (
    drive_uuid  uuid not null,
    track_index integer not null,
    frame_index integer not null,
    match_index integer not null,
    primary key (drive_uuid, track_index, frame_index, match_index)
);

create table conetl.changeset (
    changeset_id     uuid primary key,
    changeset_no     bigint generated always as identity unique,  -- rises with system time
    map_id           integer not null references conetl.map,
    drive_uuid       uuid not null references conetl.drive,
    run_id           uuid references conetl.run,
    idempotency_key  text not null check (idempotency_key ~ '^[0-9a-f]{64}$'),
    params_sha256    text not null,
    model_sha256     text not null,
    code_version     text not null,
    committed_at     timestamptz not null,  -- system time of everything in it
    added_count      integer not null,
    confirmed_count  integer not null,
    moved_count      integer not null,
    removed_count    integer not null,
    frame_pair_count integer not null,
    detection_count  integer not null,
    match_count      integer not null,
    position_count   integer not null,
    track_count      integer not null,
    rejection_count  integer not null,
    unique (map_id, idempotency_key)
);
create index changeset_by_time on conetl.changeset (map_id, committed_at);

create table conetl.quarantine (
    quarantine_id bigint generated always as identity primary key,
    changeset_id  uuid not null references conetl.changeset,
    step          text not null,
    reason        text not null,
    record        text not null,
    detail        text not null,
    payload       jsonb not null
);
create index quarantine_by_changeset on conetl.quarantine (changeset_id, reason);

create table conetl.feature (
    feature_id       uuid primary key,
    map_id           integer not null,
    srid             integer not null,
    founded_by       uuid not null,  -- changeset; no foreign key, see below
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    unique (feature_id, map_id, srid)
);
create index feature_by_map on conetl.feature (map_id);

-- Bitemporal and append-only: the one change a row may ever see is that its system period is closed. A feature that is gone
-- has a version with present = false. Periods are half-open. That changeset_id exists is checked by an audit: the one statement
-- that writes it has just made that changeset, and a foreign key per row would cost a fifth of the whole merge.
create table conetl.feature_version (
    version_row_id        bigint generated always as identity primary key,
    feature_id            uuid not null,
    version               integer not null check (version >= 1),
    map_id                integer not null,
    srid                  integer not null,
    changeset_id          uuid not null,
    present               boolean not null,
    category              text not null,
    geom                  geometry(PointZ) not null,  -- foot centre on the ground
    cov_xx                float8 not null,
    cov_xy                float8 not null,
    cov_xz                float8 not null,
    cov_yy                float8 not null,
    cov_yz                float8 not null,
    cov_zz                float8 not null,
    centre_geom           geometry(PointZ) not null,  -- box centre
    cone_height_m         float8 not null check (cone_height_m > 0 and cone_height_m < 'infinity'),
    cone_height_sigma_m   float8 not null check (cone_height_sigma_m > 0 and cone_height_sigma_m < 'infinity'),
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count >= 1),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null,
    valid_from_ns         bigint not null,            -- of this version, exact
    valid_period          tstzrange not null,         -- when it was so on the road
    system_period         tstzrange not null,         -- when the database held it for true
    foreign key (feature_id, map_id, srid) references conetl.feature (feature_id, map_id, srid),
    check (ST_SRID(geom) = srid and ST_SRID(centre_geom) = srid),
    check (cov_xx > 0 and cov_yy > 0 and cov_zz > 0),
    check (first_seen_ns <= last_seen_ns),
    check (not isempty(valid_period) and lower_inc(valid_period) and not upper_inc(valid_period)),
    check (not isempty(system_period) and lower_inc(system_period) and not upper_inc(system_period)),
    constraint no_overlap exclude using gist (feature_id with =, valid_period with &&, system_period with &&)
);
create unique index feature_version_believed on conetl.feature_version (feature_id, version) where upper_inf(system_period);
create index feature_version_by_place on conetl.feature_version using gist (geom);
create index feature_version_by_changeset on conetl.feature_version (changeset_id);

create table conetl.delta (
    changeset_id  uuid not null,
    feature_id    uuid not null references conetl.feature,
    kind          text not null check (kind in ('added', 'confirmed', 'moved', 'removed')),
    old_version   integer,
    new_version   integer not null,  -- the same as old_version where a confirmation changed nothing
    track_index   integer,
    changed_at_ns bigint not null,
    changed_at    timestamptz not null,
    shift_m       float8 check (shift_m >= 0),
    primary key (changeset_id, feature_id)
);
create index delta_by_feature on conetl.delta (feature_id);

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
