-- Purpose: where whole versions are loaded that are believed from now on (units as in feature_version). valid_to is meant only where
-- is_open is false.
create temporary table version_stage (
    feature_id            uuid not null,
    version               integer not null,
    changeset_id          uuid not null,
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
    last_seen_ns          bigint not null,
    valid_from_ns         bigint not null,
    valid_from            timestamptz not null,
    valid_to              timestamptz not null,
    is_open               boolean not null
) on commit drop;
