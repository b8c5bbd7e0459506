-- Purpose: where the deltas of one changeset are loaded, each with the state of the feature that follows from it (units as in
-- feature_version). is_change: false where a confirmation leaves everything as it was. present: not removed and not suppressed.
create temporary table delta_stage (
    feature_id            uuid not null primary key,
    kind                  text not null,
    old_version           integer,
    is_change             boolean not null,
    track_index           integer,
    changed_at_ns         bigint not null,
    changed_at            timestamptz not null,
    shift_m               float8,
    present               boolean not null,
    suppressed            boolean not null,
    category              text not null,
    geom                  geometry not null,
    cov_xx                float8 not null,
    cov_xy                float8 not null,
    cov_xz                float8 not null,
    cov_yy                float8 not null,
    cov_yz                float8 not null,
    cov_zz                float8 not null,
    centre_geom           geometry not null,
    cone_height_m         float8 not null,
    cone_height_sigma_m   float8 not null,
    existence_probability float8 not null,
    observation_count     integer not null,
    first_seen_ns         bigint not null,
    last_seen_ns          bigint not null
) on commit drop;
