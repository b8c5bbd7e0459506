-- Purpose: the rig of one drive of a map. Parameters: map_name; drive_uuid. Columns: rig (JSON).
select d.rig
from conetl.drive d
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and d.drive_uuid = %(drive_uuid)s;
