-- Purpose: where deltas are loaded that are believed from now on of drives that were compared with the map again.
create temporary table replayed_delta_stage (
    changeset_id         uuid not null,
    feature_id           uuid not null,
    kind                 text not null,
    old_version          integer,
    new_version          integer not null,
    track_index          integer,
    changed_at_ns        bigint not null,
    changed_at           timestamptz not null,
    shift_m              float8,
    other_feature_id     uuid,
    log_likelihood_ratio float8,
    existence_after      float8,
    frames_seen          integer,
    frames_empty         integer
) on commit drop;
