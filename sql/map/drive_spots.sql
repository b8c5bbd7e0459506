-- Purpose: where a drive saw cones, frame by frame. Parameters: drive_uuid.
-- Columns: frame_index, easting, northing, height (metres).
select p.frame_index, ST_X(p.geom), ST_Y(p.geom), ST_Z(p.geom)
from conetl.position p
where p.drive_uuid = %(drive_uuid)s
order by p.frame_index, p.match_index;
