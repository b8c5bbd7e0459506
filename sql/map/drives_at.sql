-- Purpose: the drives that count and whose area comes within a radius of a place. Parameters: map_name; easting_m, northing_m,
-- radius_m (map CRS, which is in metres).
-- Columns: drive_uuid.
select d.drive_uuid
from conetl.map m
join conetl.active_drive d on d.map_id = m.map_id
where m.map_name = %(map_name)s
and ST_DWithin(d.area, ST_SetSRID(ST_MakePoint(%(easting_m)s::float8, %(northing_m)s::float8), m.srid), %(radius_m)s);
