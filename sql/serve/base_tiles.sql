-- Purpose: which tiles of points a map has, coarse ones first. Parameters: map_name; max_rows.
-- Columns: level, points, origin_m, scale_m (3 each), high_m, sha256.
select t.level, t.points, t.origin_m, t.scale_m, t.high_m, t.sha256
from conetl.base_tile t
join conetl.base_source s using (source_id)
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by t.level, s.source_id, t.ix, t.iy
limit %(max_rows)s;
