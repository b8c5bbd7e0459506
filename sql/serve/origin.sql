-- Purpose: a point of the map's CRS near everything, from which the browser counts in metres (float32 holds no eastings). It
-- never changes while the map grows. Parameters: map_name. Columns: easting_m, northing_m, height_m (body of the first frame pair,
-- or the first cone of a map that began with an import).
select ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as height_m
from conetl.changeset c
join conetl.map m using (map_id)
cross join lateral (
    (select f.geom from conetl.frame_pair f where f.drive_uuid = c.drive_uuid order by f.frame_index limit 1)
    union all
    (select s.geom from conetl.statement s where s.drive_uuid = c.drive_uuid order by s.statement_index limit 1)
) p
where m.map_name = %(map_name)s
order by c.changeset_no
limit 1;
