-- Lists of a map with a million features are filtered and sorted from an index that has all that they filter and sort by: 190 MB
-- instead of a gigabyte of versions, most of which are of earlier states. Its order is the one in which the list opens. The changes
-- of a drive are found without reading those of all others; equal keys are stored once, so that index is small.

create index feature_version_now on conetl.feature_version (map_id, existence_probability, version_row_id) include (
    feature_id, category, observation_count, cov_xx, cov_yy, cov_xy, object_height_m, last_seen_ns, changeset_id, geom
)
where present and upper_inf(system_period) and upper_inf(valid_period);
create index delta_by_changeset on conetl.delta (changeset_id);
