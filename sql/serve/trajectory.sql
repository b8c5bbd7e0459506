-- Purpose: the poses of one drive, in order of time. Parameters: map_name; drive_uuid; max_rows.
-- Columns: drive_id, rig (JSON), frame_index, captured_at_ns, easting_m, northing_m, height_m (of the body), map_r_body (9).
select
    d.drive_id, d.rig, f.frame_index, f.captured_at_ns,
    ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m, ST_Z(f.geom) as height_m, f.map_r_body
from conetl.drive d
join conetl.map m using (map_id)
join conetl.frame_pair f using (drive_uuid)
where m.map_name = %(map_name)s and d.drive_uuid = %(drive_uuid)s
order by f.captured_at_ns
limit %(max_rows)s;
