-- Purpose: features that a changeset took off the map, as it was committed. Parameters: changeset_id (uuid).
-- Columns: feature_id; easting_m, northing_m, height_m (map CRS), cone_height_m: as last known.
select x.feature_id, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m, v.cone_height_m
from conetl.delta x
join conetl.changeset c using (changeset_id)
join lateral (
    select o.geom, o.cone_height_m
    from conetl.feature_version o
    where o.cell = x.cell and o.feature_id = x.feature_id and o.version = x.old_version
    order by o.system_period @> c.committed_at desc, o.version_row_id desc
    limit 1
) v on true
where x.changeset_id = %(changeset_id)s and x.kind = 'removed' and x.system_period @> c.committed_at
order by x.feature_id;
