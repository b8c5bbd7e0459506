-- Purpose: a point of the map's CRS near everything, from which the browser counts in metres (float32 holds no eastings). It
-- never changes while the map grows. Parameters: map_name. Columns: easting_m, northing_m, height_m (body, first frame pair).
select ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as height_m
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.frame_pair p using (drive_uuid)
where m.map_name = %(map_name)s
order by c.changeset_no, p.frame_index
limit 1;
