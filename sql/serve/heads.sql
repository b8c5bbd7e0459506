-- Purpose: how far every map has come, cheap enough to be asked several times a second.
-- Columns: map_name, changeset_no (the newest one of the map).
select m.map_name, max(c.changeset_no) as changeset_no
from conetl.map m
join conetl.changeset c using (map_id)
group by m.map_name;
