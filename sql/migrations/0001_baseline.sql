-- The map with its full history, the drives that it was made from, and what was rejected.
--
-- Units: metres, m^2 (covariances), pixels of the original image, radians; *_ns are UTC nanoseconds since 1970 (exact), timestamptz
-- columns beside them are the same instant cut to microseconds (for queries). Points are easting, northing of the map's CRS and
-- ellipsoidal height. Covariances are the upper triangle xx, xy, xz, yy, yz, zz.
--
-- The CRS is a property of the map (one database may hold several maps), so the geometry columns are typed PointZ without an SRID; the
-- map's SRID is enforced by foreign keys that carry it down (map -> feature -> feature_version) and a check.
--
-- The map is a pure function of the drives and decisions that went in, whatever the order in which they came. A drive keeps what is
-- needed to compare it with the map again: its parameters of comparison, and the area in which it changes or judges anything. Versions
-- and deltas are bitemporal and append-only: the one change that a row may ever see is that its system period is closed. A row whose
-- system period is open is current. Periods are half-open.

create extension if not exists postgis with schema public;
create extension if not exists btree_gist with schema public;
create schema if not exists conetl;

-- Maps, runs and drives ------------------------------------------------------------------------------------------------------------

create table conetl.map (
    map_id     integer generated always as identity primary key,
    map_name   text not null unique check (map_name ~ '^[a-z0-9_-]{1,40}$'),
    srid       integer not null check (srid > 0),
    created_at timestamptz not null,
    licence    text,
    unique (map_id, srid)
);
comment on column conetl.map.licence is 'Licence of the map''s data, part of every export; null: none was set.';

create table conetl.run (
    run_id        uuid primary key,
    started_at    timestamptz not null,
    finished_at   timestamptz not null,
    params        jsonb not null,
    flow_run_id   text,
    facts         jsonb
);
comment on table conetl.run is 'One run of the pipeline that ended in a changeset, with the parameters in full.';
comment on column conetl.run.facts is
    'Sentences and versions that no other table holds: trajectory, calibration, code_sha256, python, libraries; null: not kept.';

create table conetl.run_step (
    run_id     uuid not null references conetl.run,
    step       text not null,
    task_count integer not null check (task_count > 0),
    busy_s     float8 not null check (busy_s >= 0),   -- summed over its tasks, which may run in parallel
    started_s  float8 not null,                       -- since the run's first step began
    ended_s    float8 not null check (ended_s >= started_s),
    primary key (run_id, step)
);
comment on table conetl.run_step is 'How long each step of a run took; written after the commit, so it may be missing.';

-- An imported map is one more event of the fold: a drive of kind 'import' with its own time and the hash of the file, without a rig,
-- frame pairs and tracks; its content is in conetl.statement.
create table conetl.drive (
    drive_uuid           uuid primary key,
    map_id               integer not null,
    srid                 integer not null,
    drive_id             text not null,
    source_path          text not null,
    content_sha256       text not null check (content_sha256 ~ '^[0-9a-f]{64}$'),
    rig                  jsonb,
    captured_from_ns     bigint not null,
    captured_to_ns       bigint not null,
    captured_period      tstzrange not null,
    expected_frame_count integer not null,
    reconcile            jsonb not null,
    influence_m          float8 not null check (influence_m > 0),
    area                 geometry(Geometry) not null,  -- covers everything within influence_m of the path
    absence_figures      jsonb,
    pruned_at            timestamptz,
    kind                 text not null default 'drive' check (kind in ('drive', 'import')),
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    check (
        case kind when 'drive' then rig is not null and expected_frame_count > 0 else rig is null and expected_frame_count = 0 end
    )
);
create index drive_by_name on conetl.drive (map_id, drive_id);
create index drive_by_area on conetl.drive using gist (area);
create index drive_by_content on conetl.drive (map_id, content_sha256);
comment on table conetl.drive is
    'One ingested state of a recording: the same drive_id with other content or parameters is another row.';
comment on column conetl.drive.reconcile is 'Parameters with which the drive is compared with the map, also when it is replayed.';
comment on column conetl.drive.absence_figures is
    'Measured figures of the detector (P(detect | height, hidden share)) and its score threshold; null: not kept.';
comment on column conetl.drive.pruned_at is
    'When its detections, stereo matches and positions were deleted by policy; null while they exist. A pruned drive cannot be replayed.';
comment on column conetl.drive.kind is 'import: not a recording, but a map that was made elsewhere, with the instant that it describes.';

-- Raw records of a drive ------------------------------------------------------------------------------------------------------------
-- They are loaded by COPY, millions at a time, and checked in memory before; a foreign key per row would double the load time, so an
-- audit checks that they belong together.

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
    foot_left_u_px float8 not null, foot_left_v_px float8 not null,
    foot_right_u_px float8 not null, foot_right_v_px float8 not null,
    centre_left_u_px float8 not null, centre_left_v_px float8 not null,
    centre_right_u_px float8 not null, centre_right_v_px float8 not null,
    tip_left_u_px float8 not null, tip_left_v_px float8 not null,
    tip_right_u_px float8 not null, tip_right_v_px float8 not null,
    sigma_u_px float8 not null, sigma_v_px float8 not null,
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
    cov_xx float8 not null, cov_xy float8 not null, cov_xz float8 not null,
    cov_yy float8 not null, cov_yz float8 not null,
    cov_zz float8 not null,
    centre_geom      geometry(PointZ) not null,  -- box centre
    cone_height_m    float8 not null,
    camera_x_m       float8 not null,            -- foot in the left camera's frame
    camera_y_m       float8 not null,
    camera_z_m       float8 not null,
    camera_cov_xx float8 not null, camera_cov_xy float8 not null, camera_cov_xz float8 not null,
    camera_cov_yy float8 not null, camera_cov_yz float8 not null,
    camera_cov_zz float8 not null,
    range_m          float8 not null,
    ray_angle_rad    float8 not null,
    residual_rms_px  float8 not null,
    iterations       integer not null,
    score            float8 not null,
    primary key (drive_uuid, frame_index, match_index)
);

-- calibrations and shared_jacobian_m say which part of a covariance other drives with the same calibration share, so that the error of
-- a rig's calibration is not averaged away over its drives. Both are null where nothing of it is known: rigs without a stated
-- covariance, imported maps.
create table conetl.track (
    drive_uuid            uuid not null references conetl.drive,
    track_index           integer not null,
    category              text not null,
    geom                  geometry(PointZ) not null,
    cov_xx float8 not null, cov_xy float8 not null, cov_xz float8 not null,
    cov_yy float8 not null, cov_yz float8 not null,
    cov_zz float8 not null,
    relative_cov_xx float8 not null, relative_cov_xy float8 not null, relative_cov_xz float8 not null,
    relative_cov_yy float8 not null, relative_cov_yz float8 not null,
    relative_cov_zz float8 not null,
    centre_geom           geometry(PointZ) not null,
    cone_height_m         float8 not null,
    cone_height_sigma_m   float8 not null,
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count > 0),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null,
    residual_rms_px       float8 not null,
    nearest_range_m       float8 not null,
    calibrations          uuid[],
    shared_jacobian_m     real[],
    primary key (drive_uuid, track_index)
);
comment on column conetl.track.calibrations is
    'Calibrations whose error is in the covariance: as given to the drive, before any self-calibration; null: not known.';
comment on column conetl.track.shared_jacobian_m is
    'shared_jacobian_m[c][axis][k]: metres by which one sigma of error k of calibration c moves the position to the east, north and up (1, 2, 3).';

create table conetl.track_member (
    drive_uuid  uuid not null,
    track_index integer not null,
    frame_index integer not null,
    match_index integer not null,
    primary key (drive_uuid, track_index, frame_index, match_index)
);

create table conetl.statement (
    drive_uuid            uuid not null references conetl.drive,
    statement_index       integer not null check (statement_index >= 0),
    feature_id            uuid not null,  -- as in the file; a feature that the fold finds at the position keeps its own
    category              text not null,
    geom                  geometry(PointZ) not null,
    cov_xx float8 not null, cov_xy float8 not null, cov_xz float8 not null,
    cov_yy float8 not null, cov_yz float8 not null,
    cov_zz float8 not null,
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
comment on table conetl.statement is 'Content of an imported map: the cones that it states.';

-- Changesets ------------------------------------------------------------------------------------------------------------------------

create table conetl.changeset (
    changeset_id         uuid primary key,
    changeset_no         bigint generated always as identity unique,  -- rises with system time
    map_id               integer not null references conetl.map,
    drive_uuid           uuid not null references conetl.drive,
    run_id               uuid references conetl.run,
    idempotency_key      text not null check (idempotency_key ~ '^[0-9a-f]{64}$'),
    params_sha256        text not null,
    model_sha256         text not null,
    code_version         text not null,
    committed_at         timestamptz not null,  -- system time of everything in it
    added_count          integer not null,
    confirmed_count      integer not null,
    moved_count          integer not null,
    removed_count        integer not null,
    frame_pair_count     integer not null,
    detection_count      integer not null,
    match_count          integer not null,
    position_count       integer not null,
    track_count          integer not null,
    rejection_count      integer not null,
    missed_count         integer not null,
    height_changed_count integer not null,
    split_count          integer not null,
    merged_count         integer not null,
    unique (map_id, idempotency_key)
);
create index changeset_by_time on conetl.changeset (map_id, committed_at);
create index changeset_by_drive on conetl.changeset (drive_uuid);

-- A run that is killed between its commit and its events leaves a changeset without a row here; the next run that meets the drive
-- publishes it then. Append-only.
create table conetl.changeset_published (
    changeset_id uuid primary key references conetl.changeset,
    published_at timestamptz not null default clock_timestamp()
);
comment on table conetl.changeset_published is 'Changesets whose events were handed to Prefect.';

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

-- Features, versions and deltas -----------------------------------------------------------------------------------------------------
-- Features of one road are stored together in every index, so that a drive into a map of ten million features reads a few pages of each
-- and not one page per feature: ids are hashes (UUIDv5 of the first evidence), which are spread over the whole index. So each feature
-- keeps the cell of 256 m in which it was created, forever, and keys begin with it. The cell is internal to the database: no record,
-- export or id contains it. conetl.feature has one row per id (feature_by_id), so an id has one cell, and foreign keys carry it into
-- versions and deltas: (cell, id) is the same or different exactly where the id is.

-- South to north in rows of cells, west to east within a row. Numbers beyond all maps are cut off instead of being rejected here.
create function conetl.cell_at(point geometry) returns bigint
language sql immutable strict parallel safe
as $$
    select
        (least(greatest(floor(ST_Y(point) / 256), -1073741824), 1073741824)::bigint << 32)
        + least(greatest(floor(ST_X(point) / 256), -1073741824), 1073741824)::bigint
$$;
comment on function conetl.cell_at is 'The square of 256 m (map CRS) around a point, as one number; neighbours have near numbers.';

create table conetl.feature (
    feature_id uuid not null,
    map_id     integer not null constraint map_ids_are_positive check (map_id > 0),
    srid       integer not null,
    created_by uuid not null,  -- changeset; no foreign key, see feature_version
    cell       bigint not null,
    primary key (cell, feature_id),
    unique (cell, feature_id, map_id, srid),
    foreign key (map_id, srid) references conetl.map (map_id, srid)
);
-- One row per id. The condition holds for every row, and keeps the planner from this index where a cell is known: by its estimates it
-- costs as much, and checks of foreign keys would use it. Queries by id alone state "and map_id > 0", or call conetl.cell_of.
create unique index feature_by_id on conetl.feature (feature_id) where map_id > 0;
comment on column conetl.feature.cell is 'Cell of 256 m in which it was created (conetl.cell_at); never changes, even when it is moved.';

create function conetl.cell_of(feature_id uuid) returns bigint
language sql stable parallel safe
as $$
    select f.cell from conetl.feature f where f.feature_id = $1 and f.map_id > 0
$$;
comment on function conetl.cell_of is 'The cell in which a feature was created, which keys begin with; null where there is no such feature.';

-- The constraint no_overlap: a GiST index on (cell, feature, valid period) has no order, so a search reads every page that may hold an
-- entry, 16 pages of a map of a million features, up to 40 % of the server's work in a merge. Its first column is a box instead:
-- horizontally a number that is near for features of one cell and nearly unique; vertically the valid period in microseconds. A search
-- reads 5 pages. It is no weaker: the id stays in the constraint, an id has one cell, and periods are of whole microseconds and
-- half-open, so their boxes end one microsecond before them and overlap exactly where valid periods do.

-- 15 bits of the cell's row, 16 of its column, 22 of the id's hash: whole numbers that float8 can hold. On a map larger than these bits,
-- distant cells share numbers.
create function conetl.feature_number(cell bigint, feature_id uuid) returns float8
language sql immutable parallel safe
as $$
    select (((cell >> 32 & 32767) << 38) | ((cell & 65535) << 22) | (uuid_hash(feature_id) & 4194303))::float8
$$;
comment on function conetl.feature_number is
    'Nearly one number per feature, near for features of the same cell: its coordinate in the constraint no_overlap.';

-- Exact until 2106; after that neighbouring microseconds may become equal, but never change their order.
create function conetl.microseconds(instant timestamptz) returns float8
language sql immutable parallel safe
as $$
    select greatest(least(round(date_part('epoch', instant at time zone 'UTC') * 1000000), 9.3e18), -9.3e18)
$$;
comment on function conetl.microseconds is 'Since 1970-01-01 UTC, as float8; 9.3e18, later than all instants, for infinity and null.';

create function conetl.version_box(cell bigint, feature_id uuid, valid_period tstzrange) returns box
language sql immutable parallel safe
as $$
    select box(
        point(conetl.feature_number(cell, feature_id), conetl.microseconds(lower(valid_period))),
        point(conetl.feature_number(cell, feature_id), conetl.microseconds(upper(valid_period)) - 1)
    )
$$;
comment on function conetl.version_box is
    'A version as a line in the plane of features and time: those of one feature overlap where their valid periods do.';

-- A removed feature has a version with present = false. That changeset_id exists is checked by an audit: the one statement that writes
-- it has just inserted that changeset, and a foreign key per row would cost a fifth of the whole merge.
--
-- no_overlap covers current versions only, at half the cost of a merge. That is enough: versions are written with an open system period
-- that is closed at the instant of a later changeset of the map, so two versions of one system time were open together when the later
-- one was written. The audit overlapping_periods checks that nobody changed closed ones.
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
    cov_xx float8 not null, cov_xy float8 not null, cov_xz float8 not null,
    cov_yy float8 not null, cov_yz float8 not null,
    cov_zz float8 not null,
    centre_geom           geometry(PointZ) not null,  -- box centre
    cone_height_m         float8 not null check (cone_height_m > 0 and cone_height_m < 'infinity'),
    cone_height_sigma_m   float8 not null check (cone_height_sigma_m > 0 and cone_height_sigma_m < 'infinity'),
    existence_probability float8 not null check (existence_probability between 0 and 1),
    observation_count     integer not null check (observation_count >= 1),
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null,
    valid_from_ns         bigint not null,            -- of this version, exact
    valid_period          tstzrange not null,         -- when it was so on the road
    system_period         tstzrange not null,         -- when it was so in the database
    suppressed            boolean not null default false,  -- a person decided that nothing stands here: compared with drives, not shown
    cell                  bigint not null,
    calibrations          uuid[],
    shared_jacobian_m     real[],
    constraint feature_of_version foreign key (cell, feature_id, map_id, srid)
        references conetl.feature (cell, feature_id, map_id, srid),
    constraint suppressed_is_not_present check (not (suppressed and present)),
    check (ST_SRID(geom) = srid and ST_SRID(centre_geom) = srid),
    check (cov_xx > 0 and cov_yy > 0 and cov_zz > 0),
    check (first_seen_ns <= last_seen_ns),
    check (not isempty(valid_period) and lower_inc(valid_period) and not upper_inc(valid_period)),
    check (not isempty(system_period) and lower_inc(system_period) and not upper_inc(system_period)),
    constraint no_overlap exclude using gist (conetl.version_box(cell, feature_id, valid_period) with &&, feature_id with =)
        where (upper_inf(system_period))
);
-- One current row per number of a version; over all rows, because it also serves the history of a feature.
create unique index feature_version_current
    on conetl.feature_version (cell, feature_id, version, coalesce(upper(system_period), 'infinity'));
create index feature_version_by_position on conetl.feature_version using gist (geom);
comment on column conetl.feature_version.calibrations is
    'Calibrations whose error is in the covariance, of the drives that determined the position, in ascending order; null: none known.';
comment on column conetl.feature_version.shared_jacobian_m is
    'shared_jacobian_m[c][axis][k]: metres by which one sigma of error k of calibration c moves the position to the east, north and up (1, 2, 3).';

-- What drives say for a feature and against it, whether it changes the feature or not: a drive to which a feature was visible and that
-- did not observe it leaves a delta of kind 'missed', which makes no version (old_version = new_version), like a confirmation that
-- changes nothing. log_likelihood_ratio: ln p(what the drive saw | it stands) / p(same | it does not); existence_after: existence
-- probability after the drive; frames_seen, frames_empty: frame pairs in which it was observed, and in which it was visible but not
-- observed. Null in rows of mergers; imported maps have frames_seen 0.
create table conetl.delta (
    changeset_id         uuid not null,
    feature_id           uuid not null,
    kind                 text not null check (
        kind in ('added', 'confirmed', 'moved', 'removed', 'missed', 'height_changed', 'split', 'merged')
    ),
    old_version          integer,
    new_version          integer not null,  -- the same as old_version where a confirmation changed nothing
    track_index          integer,
    changed_at_ns        bigint not null,
    changed_at           timestamptz not null,
    shift_m              float8 check (shift_m >= 0),
    delta_row_id         bigint generated always as identity primary key,
    system_period        tstzrange not null,
    other_feature_id     uuid,  -- of a split: the common origin; of a merger: the feature that is left
    log_likelihood_ratio float8,
    existence_after      float8 check (existence_after between 0 and 1),
    frames_seen          integer check (frames_seen >= 0),
    frames_empty         integer check (frames_empty >= 0),
    cell                 bigint not null,
    constraint feature_of_delta foreign key (cell, feature_id) references conetl.feature (cell, feature_id),
    constraint missed_changes_nothing check (kind <> 'missed' or (old_version = new_version and existence_after is not null)),
    check (not isempty(system_period) and lower_inc(system_period) and not upper_inc(system_period))
);
create unique index delta_current on conetl.delta (changeset_id, feature_id) where upper_inf(system_period);
create index delta_by_feature on conetl.delta (cell, feature_id);
-- The few features in doubt are found without reading all that was ever seen.
create index delta_missed on conetl.delta (cell, feature_id, old_version) where kind = 'missed' and upper_inf(system_period);
comment on column conetl.delta.system_period is
    'When this was the drive''s effect in the database; an earlier drive that arrives later ends it and writes another.';

-- Features around an oblique road: the box around its whole area may hold a hundred times as much. Pieces are cut by number of vertices,
-- so a straight road gets some first: a piece is at most about 1.5 km of it.
create function conetl.pieces(area geometry) returns setof geometry
language sql immutable parallel safe rows 1
as $$
    select area where 4 * ST_Area(area) >= ST_Area(ST_Envelope(area))
    union all
    select p.piece from ST_Subdivide(ST_Segmentize(area, 50), 64) p (piece) where 4 * ST_Area(area) < ST_Area(ST_Envelope(area))
$$;
comment on function conetl.pieces is
    'An area, subdivided where its bounding box is more than four times as large, for indexes on boxes. Pieces share their edges.';

-- Decisions -------------------------------------------------------------------------------------------------------------------------
-- What a person decides takes part in every later comparison. Append-only. Suppress: nothing stands within radius_m of geom, whatever
-- drives see. Pin: drives neither remove nor move a cone within radius_m of geom. Revert: the changeset's drive is not active.
-- Withdraw: the decision that it names does not hold any more.

create table conetl.decision (
    decision_id  uuid primary key,
    decision_no  bigint generated always as identity unique,
    map_id       integer not null,
    srid         integer not null,
    kind         text not null check (kind in ('suppress', 'pin', 'revert', 'withdraw')),
    geom         geometry(Point),
    radius_m     float8 check (radius_m > 0 and radius_m < 'infinity'),
    feature_id   uuid,     -- that the person selected; no foreign key: a later fold may not contain it
    changeset_id uuid references conetl.changeset,
    withdraws    uuid unique references conetl.decision,
    note         text not null,
    decided_at   timestamptz not null,  -- system time
    decided_by   text check (decided_by <> ''),
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    check ((kind in ('suppress', 'pin')) = (geom is not null and radius_m is not null)),
    check (geom is null or ST_SRID(geom) = srid),
    check ((kind = 'revert') = (changeset_id is not null)),
    check ((kind = 'withdraw') = (withdraws is not null))
);
create index decision_by_map on conetl.decision (map_id, decided_at);
comment on column conetl.decision.decided_by is 'Name of the person, as given; null: not given.';

create view conetl.active_decision as
select d.*
from conetl.decision d
where d.kind <> 'withdraw' and not exists (select from conetl.decision w where w.withdraws = d.decision_id);
comment on view conetl.active_decision is 'Decisions that were not withdrawn.';

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

-- The map now, at any instant, and the evidence for it ------------------------------------------------------------------------------

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

create view conetl.sighting_evidence as
select
    m.map_name, x.feature_id, c.drive_uuid, x.changeset_id, x.kind,
    x.kind not in ('missed', 'removed') as seen,
    x.log_likelihood_ratio, x.existence_after, x.frames_seen, x.frames_empty,
    x.old_version, x.new_version, x.changed_at as observed_at, x.system_period
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
where x.kind <> 'merged';
comment on view conetl.sighting_evidence is
    'One row per drive and feature that it observed, or missed although visible; current where upper_inf(system_period).';

-- Drives that observed and that missed a feature until an instant on the road, as the database knew it at another instant; and the
-- existence probability of its version of that number after them (null: no drive missed that version). Imported maps are not counted.
create function conetl.feature_evidence(
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
    where x.cell = conetl.cell_of($1)
    and x.feature_id = $1 and x.changed_at <= $3 and x.system_period @> $4
$$;
comment on function conetl.feature_evidence is
    'Numbers of drives that observed and that missed a feature, and its existence probability after the latest miss.';

-- Base layers: point clouds as tiles, and lane boundaries, each with the file that it came from. ------------------------------------
-- They are not part of the map's history: they are loaded, renewed and dropped as a whole. Coordinates are those of the map's CRS, in
-- metres. A tile's points count from its origin in steps of its scale (bytes: readers/base_layers/point_tiles.py).

create table conetl.base_source (
    source_id      uuid primary key,
    map_id         integer not null,
    srid           integer not null,
    layer_name     text not null check (layer_name ~ '^[A-Za-z0-9][A-Za-z0-9 ._-]{0,59}$'),
    kind           text not null check (kind in ('points', 'lines')),
    source_path    text not null,
    content_sha256 text not null check (content_sha256 ~ '^[0-9a-f]{64}$'),  -- of the file
    params         jsonb not null,
    source_crs     text not null,
    read_count     bigint not null check (read_count >= 0),     -- points or lines in the file
    kept_count     bigint not null check (kept_count > 0),      -- after thinning
    refused_count  bigint not null check (refused_count >= 0),  -- not numbers, or not expressible in the map's CRS
    heights        text not null check (heights in ('file', 'drives')),
    extent         geometry(Polygon) not null,
    imported_at    timestamptz not null default clock_timestamp(),
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    check (ST_SRID(extent) = srid)
);
create unique index base_source_once on conetl.base_source (map_id, layer_name, content_sha256, md5(params::text));
comment on table conetl.base_source is 'One imported file of a base layer; a layer is all sources of one name.';
comment on column conetl.base_source.heights is
    'file: as in the file; drives: the file has none, each vertex has the ground height of the nearest pose.';

create table conetl.base_tile (
    -- Deferred: the source is written last, when its counts are known.
    source_id uuid not null references conetl.base_source on delete cascade deferrable initially deferred,
    level     smallint not null check (level between 0 and 9),
    ix        integer not null,
    iy        integer not null,
    points    integer not null check (points > 0),
    origin_m  float8[] not null check (cardinality(origin_m) = 3),
    scale_m   float8[] not null check (cardinality(scale_m) = 3),
    high_m    float8 not null,
    sha256    text not null check (sha256 ~ '^[0-9a-f]{64}$'),
    payload   bytea not null,
    primary key (source_id, level, ix, iy)
);
create index base_tile_by_content on conetl.base_tile (sha256);
alter table conetl.base_tile alter column payload set storage external;  -- compressed already
comment on table conetl.base_tile is 'Points of one square and level of detail; tiles of all levels together are the cloud.';

create table conetl.base_line (
    line_id    bigint generated always as identity primary key,
    source_id  uuid not null references conetl.base_source on delete cascade deferrable initially deferred,
    kind       text not null,
    attributes jsonb not null,
    geom       geometry(LineStringZ) not null
);
create index base_line_by_source on conetl.base_line (source_id);
create index base_line_by_position on conetl.base_line using gist (geom);
comment on table conetl.base_line is 'Lane boundaries, markings, kerbs and reference lines; kind is the term of the file.';

-- Receipts: what became of every drive that was handed over -------------------------------------------------------------------------
-- One row when work on it starts, one when it ends. Append-only. An attempt that started, has not ended, and whose lock nobody holds
-- (locks.held_locks) was interrupted. header_sha256 identifies a drive without its images: its id, calibration, time stamps, first
-- poses and the names of its files.

create table conetl.receipt (
    receipt_no      bigint generated always as identity primary key,
    attempt_id      uuid not null,
    map_name        text not null check (map_name ~ '^[a-z0-9_-]{1,40}$'),  -- no foreign key: the first drive creates the map
    drive_path      text not null,
    drive_id        text not null,
    header_sha256   text not null check (header_sha256 ~ '^[0-9a-f]{64}$'),
    analysis_sha256 text not null check (analysis_sha256 ~ '^[0-9a-f]{64}$'),  -- parameters and model
    content_sha256  text check (content_sha256 ~ '^[0-9a-f]{64}$'),            -- null where the drive could not be read
    state           text not null check (state in ('started', 'committed', 'known', 'failed', 'crashed')),
    reason          text not null,        -- of failed and crashed: why; of committed: what needs a person, else ''
    may_pass        boolean not null,     -- a new attempt may succeed although the drive is the same
    changeset_id    uuid references conetl.changeset,
    frame_pairs     integer check (frame_pairs >= 0),
    seconds         float8 check (seconds >= 0),
    flow_run_id     text,
    host            text not null,
    at              timestamptz not null default clock_timestamp(),
    check ((state in ('committed', 'known')) = (changeset_id is not null)),
    check (state not in ('failed', 'crashed') or reason <> '')
);
create unique index receipt_of_attempt on conetl.receipt (attempt_id, (state = 'started'));
create index receipt_by_drive on conetl.receipt (map_name, header_sha256, receipt_no desc);
comment on table conetl.receipt is 'What became of every drive that was handed over; two rows per attempt: its start and its end.';

create view conetl.latest_receipt as
select distinct on (map_name, header_sha256) *
from conetl.receipt
order by map_name, header_sha256, receipt_no desc;
comment on view conetl.latest_receipt is 'The last receipt of every drive; started and no lock held: it was interrupted.';

-- Watched drives: features that a drive shows while it is still being recorded ------------------------------------------------------
-- They are not part of the map: no version, delta, audit or export contains them. They are replaced while the drive is watched and
-- deleted when it is ingested. No foreign key to conetl.map: the first ingest creates a map, watching never does.

create table conetl.watched_drive (
    watch_id         uuid primary key,
    map_name         text not null check (map_name ~ '^[a-z0-9_-]{1,40}$'),
    srid             integer not null check (srid > 0),
    drive_id         text not null,
    source_path      text not null,
    started_at       timestamptz not null default clock_timestamp(),
    ended_at         timestamptz,              -- null: being watched, or its watcher died
    captured_from_ns bigint not null,          -- of the frame pairs processed so far
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
    cov_xx float8 not null, cov_xy float8 not null, cov_xz float8 not null,
    cov_yy float8 not null, cov_yz float8 not null,
    cov_zz float8 not null,
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

-- Notifications: open pages learn of a change at once -------------------------------------------------------------------------------
-- Whatever is committed to a map (a changeset, a decision, a base layer that was imported or dropped) is notified on the channel
-- conetl_change, without content: listeners read the new state. NOTIFY is sent at commit, once per transaction.

create function conetl.notify_change() returns trigger
language plpgsql
as $$
begin
    perform pg_notify('conetl_change', '');
    return null;
end
$$;
comment on function conetl.notify_change is 'Trigger: this transaction changed something that the web view shows.';

create trigger notify_change after insert on conetl.changeset for each statement execute function conetl.notify_change();
create trigger notify_change after insert on conetl.decision for each statement execute function conetl.notify_change();
create trigger notify_change after insert or update or delete on conetl.base_source
for each statement execute function conetl.notify_change();

-- OGC API Features and vector tiles: the map as of an instant, and its changes between two ------------------------------------------
-- All functions only read, and are plain queries of one statement, so that PostgreSQL inlines them into the query that calls them and a
-- filter, an order or a limit outside reaches the tables inside. Positions are longitude and latitude (EPSG:4326) with the map's
-- ellipsoidal height (m). GeoJSON prints billionths of a degree (a tenth of a millimetre), and the edge of a box is as exact: a
-- coordinate of an answer as the edge of a box finds that item. Instants are in a select of their own, so that their text is parsed
-- once and not once per row.
--
-- A box has three forms, because an index contains the map's own CRS only:
-- - west, south, east, north (degrees, edges included; west > east crosses 180 degrees) determine the answer.
-- - min_x_m .. max_y_m (map CRS) is a box around it that finds the rows. Without it the answer is the same and every row is tested.
-- - inner_min_x_m .. inner_max_y_m (map CRS) is certainly inside it: features in it need no other test. Only what is between the two is
--   transformed to degrees. The default holds nothing, which leaves every row to the transformation: the answer is the same.

create schema conetl_ogc;
comment on schema conetl_ogc is 'Functions behind OGC API Features and vector tiles; read-only.';

-- Which features stood in a box between two instants, and their versions; of an interval the last version of each. Evidence is left to
-- conetl_ogc.features, so that a page looks it up for its own items only. by_place false, written as such into a statement, is a plan
-- that reads the whole table: for most of it that takes less time than the index of positions, and a plan that is made once per session
-- does not know how much a box holds; the box in the map's CRS then still saves transformations. version_row_id fetches a page once it
-- is known which versions are on it.
create function conetl_ogc.standing(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30,
    inner_min_x_m float8 default 1e30, inner_min_y_m float8 default 1e30,
    inner_max_x_m float8 default -1e30, inner_max_y_m float8 default -1e30,
    by_place boolean default true
)
returns table (
    feature_id uuid, version integer, category text, existence_probability float8,
    easting_m float8, northing_m float8, height_m float8,
    sigma_east_m float8, sigma_north_m float8, sigma_height_m float8, cov_xy_m2 float8,
    cone_height_m float8, cone_height_sigma_m float8, observation_count integer,
    first_seen_at timestamptz, last_seen_at timestamptz, valid_from timestamptz, valid_to timestamptz,
    geom geometry, version_row_id bigint
)
language sql stable
as $$
    select
        v.feature_id, v.version, v.category, v.existence_probability,
        ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
        sqrt(v.cov_xx), sqrt(v.cov_yy), sqrt(v.cov_zz), v.cov_xy,
        v.cone_height_m, v.cone_height_sigma_m, v.observation_count,
        timestamptz 'epoch' + v.first_seen_ns / 1000 * interval '1 microsecond',
        timestamptz 'epoch' + v.last_seen_ns / 1000 * interval '1 microsecond',
        lower(v.valid_period), upper(v.valid_period),
        ST_Transform(v.geom, 4326), v.version_row_id
    from conetl.map m
    join conetl.feature_version v using (map_id)
    where m.map_name = $1 and v.present
    and v.valid_period && (select tstzrange($2, $3, '[]')) and v.system_period @> (select $4)
    and (
        (select $2 = $3) or not exists (
            select from conetl.feature_version later
            where later.cell = v.cell and later.feature_id = v.feature_id and later.present
            and later.valid_period && (select tstzrange($2, $3, '[]'))
            and later.system_period @> (select $4) and lower(later.valid_period) > lower(v.valid_period)
        )
    )
    and (not $17 or v.geom && ST_MakeEnvelope($9, $10, $11, $12))
    and (
        ($5 <= -180 and $6 <= -90 and $7 >= 180 and $8 >= 90)
        or (ST_X(v.geom) between $13 and $15 and ST_Y(v.geom) between $14 and $16)
        or (
            ST_X(v.geom) between $9 and $11 and ST_Y(v.geom) between $10 and $12
            and ST_Y(ST_Transform(v.geom, 4326)) between $6 - 5e-10 and $8 + 5e-10
            and case
                when $5 <= $7 then ST_X(ST_Transform(v.geom, 4326)) between $5 - 5e-10 and $7 + 5e-10
                else ST_X(ST_Transform(v.geom, 4326)) >= $5 - 5e-10 or ST_X(ST_Transform(v.geom, 4326)) <= $7 + 5e-10
            end
        )
    )
$$;
comment on function conetl_ogc.standing is
    'The cones of a map that stood between two instants on the road, as the database knew it; existence_probability is that of the version.';

-- conetl_ogc.standing with existence and counts of drives, for callers that filter and order by them. They are those of
-- conetl.feature_evidence, written out because a call per row costs five times as much.
create function conetl_ogc.features(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30,
    inner_min_x_m float8 default 1e30, inner_min_y_m float8 default 1e30,
    inner_max_x_m float8 default -1e30, inner_max_y_m float8 default -1e30
)
returns table (
    feature_id uuid, version integer, category text, existence_probability float8,
    easting_m float8, northing_m float8, height_m float8,
    sigma_east_m float8, sigma_north_m float8, sigma_height_m float8, cov_xy_m2 float8,
    cone_height_m float8, cone_height_sigma_m float8, observation_count integer, seen_count integer, missed_count integer,
    first_seen_at timestamptz, last_seen_at timestamptz, valid_from timestamptz, valid_to timestamptz,
    geom geometry
)
language sql stable
as $$
    select
        s.feature_id, s.version, s.category,
        coalesce(
            (
                select x.existence_after
                from conetl.delta x
                join conetl.changeset c using (changeset_id)
                join conetl.drive d using (drive_uuid)
                where x.cell = f.cell and x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
                and x.kind = 'missed' and x.old_version = s.version
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
                limit 1
            ),
            s.existence_probability
        ),
        s.easting_m, s.northing_m, s.height_m, s.sigma_east_m, s.sigma_north_m, s.sigma_height_m, s.cov_xy_m2,
        s.cone_height_m, s.cone_height_sigma_m, s.observation_count,
        (
            select count(*)::integer
            from conetl.delta x
            join conetl.changeset c using (changeset_id)
            join conetl.drive d using (drive_uuid)
            where x.cell = f.cell and x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive'
        ),
        (
            select count(*)::integer
            from conetl.delta x
            where x.cell = f.cell and x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind in ('missed', 'removed')
        ),
        s.first_seen_at, s.last_seen_at, s.valid_from, s.valid_to, s.geom
    from conetl_ogc.standing($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16) s
    join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0
$$;
comment on function conetl_ogc.features is 'The cones of a map that stood between two instants on the road, as the database knew it.';

-- Kinds as in the browser's comparison: moved from moved_from_m (m, on the ground), confirmed where only values are newer; the same
-- version is not a change. geom is the position afterwards, of a removed feature the one before.
--
-- changed_at is the instant of the change, also where the cone was confirmed in between: added is the beginning of the first version
-- that stood since from_at, moved that of the first version at that distance from the old position, removed the end of the last version
-- that began until to_at, all as known at known_to; confirmed is the newest confirmation. Null: as known at known_to it never stood.
-- Versions are looked up for returned rows only: the column is outside of the union, where a page's limit is applied before it.
create function conetl_ogc.changes(
    map_name text,
    from_at timestamptz default '-infinity', known_from timestamptz default 'infinity',
    to_at timestamptz default 'infinity', known_to timestamptz default 'infinity', moved_from_m float8 default 0.5,
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30
)
returns table (
    feature_id uuid, kind text, changed_at timestamptz, shift_m float8, category text,
    easting_m float8, northing_m float8, height_m float8,
    old_easting_m float8, old_northing_m float8, old_height_m float8,
    existence_probability float8, observation_count integer, cone_height_m float8, version integer,
    geom geometry
)
language sql stable
as $$
    select
        c.feature_id, c.kind,
        case c.kind
            when 'confirmed' then c.valid_from
            when 'removed' then (
                select max(upper(v.valid_period))
                from conetl.feature_version v
                where v.cell = c.cell and v.feature_id = c.feature_id and v.present
                and lower(v.valid_period) <= (select $4) and v.system_period @> (select $5)
            )
            else (
                select min(lower(v.valid_period))
                from conetl.feature_version v
                where v.cell = c.cell and v.feature_id = c.feature_id and v.present
                and (v.valid_period @> (select $2) or lower(v.valid_period) between (select $2) and (select $4))
                and v.system_period @> (select $5)
                and (c.kind = 'added' or ST_Distance(v.geom, c.old_point) >= $6)
            )
        end,
        c.shift_m, c.category,
        ST_X(c.point), ST_Y(c.point), ST_Z(c.point),
        ST_X(c.old_point), ST_Y(c.old_point), ST_Z(c.old_point),
        c.existence_probability, c.observation_count, c.cone_height_m, c.version,
        ST_Transform(c.point, 4326)
    from (
        select
            a.cell, a.feature_id,
            case
                when b.feature_id is null then 'added'
                when ST_Distance(a.geom, b.geom) >= $6 then 'moved'
                else 'confirmed'
            end as kind,
            lower(a.valid_period) as valid_from,
            ST_Distance(a.geom, b.geom) as shift_m,
            a.category, a.geom as point, b.geom as old_point, a.existence_probability, a.observation_count, a.cone_height_m, a.version
        from conetl.map m
        join conetl.feature_version a using (map_id)
        left join conetl.feature_version b
            on b.cell = a.cell and b.feature_id = a.feature_id and b.present
            and b.valid_period @> (select $2) and b.system_period @> (select $3)
        where m.map_name = $1 and a.present
        and a.valid_period @> (select $4) and a.system_period @> (select $5)
        and (b.feature_id is null or a.version <> b.version or not ST_Equals(a.geom, b.geom))
        and a.geom && ST_MakeEnvelope($11, $12, $13, $14)
        union all
        select
            b.cell, b.feature_id, 'removed', lower(b.valid_period), null,
            b.category, b.geom, b.geom, b.existence_probability, b.observation_count, b.cone_height_m, b.version
        from conetl.map m
        join conetl.feature_version b using (map_id)
        where m.map_name = $1 and b.present
        and b.valid_period @> (select $2) and b.system_period @> (select $3)
        and b.geom && ST_MakeEnvelope($11, $12, $13, $14)
        and not exists (
            select from conetl.feature_version a
            where a.cell = b.cell and a.feature_id = b.feature_id and a.present
            and a.valid_period @> (select $4) and a.system_period @> (select $5)
        )
    ) c
    where
        ($7 <= -180 and $8 <= -90 and $9 >= 180 and $10 >= 90)
        or (
            ST_Y(ST_Transform(c.point, 4326)) between $8 - 5e-10 and $10 + 5e-10
            and case
                when $7 <= $9 then ST_X(ST_Transform(c.point, 4326)) between $7 - 5e-10 and $9 + 5e-10
                else ST_X(ST_Transform(c.point, 4326)) >= $7 - 5e-10 or ST_X(ST_Transform(c.point, 4326)) <= $9 + 5e-10
            end
        )
$$;
comment on function conetl_ogc.changes is 'How a map differs between two instants on the road, each as the database knew it.';
