-- Purpose: where the drives of a map were, thinned to about max_rows. Parameters: map_name; max_rows.
-- Columns: easting_m, northing_m, height_m (of the body).
with pose as (
    select f.geom, row_number() over (order by f.drive_uuid, f.frame_index) as n, count(*) over () as pose_count
    from conetl.frame_pair f
    join conetl.drive d using (drive_uuid)
    join conetl.map m using (map_id)
    where m.map_name = %(map_name)s
)

select ST_X(geom) as easting_m, ST_Y(geom) as northing_m, ST_Z(geom) as height_m
from pose
where n %% greatest(1, pose_count / %(max_rows)s) = 0;
