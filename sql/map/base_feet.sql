-- Purpose: feet of standing cones, which tell how high the road is. Parameters: map_name; max_rows.
-- Columns: easting_m, northing_m, height_m.
select ST_X(geom) as easting_m, ST_Y(geom) as northing_m, ST_Z(geom) as height_m
from conetl.current_feature
where map_name = %(map_name)s
order by feature_id
limit %(max_rows)s;
