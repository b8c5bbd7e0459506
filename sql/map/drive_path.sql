-- Purpose: where a drive was. Parameters: drive_uuid. Columns: easting, northing (metres of the map's CRS), by frame.
select ST_X(p.geom), ST_Y(p.geom)
from conetl.frame_pair p
where p.drive_uuid = %(drive_uuid)s
order by p.frame_index;
