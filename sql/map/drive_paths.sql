-- Purpose: where the drives went that make a map, without points that a straight line explains.
-- Parameters: map_name; valid_until (timestamptz; 'infinity' = all): drives that began later are left out; tolerance_m.
-- Columns: drive_id, captured_from_ns, eastings_m, northings_m (arrays, map CRS, in order of time). A drive that stood still has none.
select
    d.drive_id, d.captured_from_ns,
    array_agg(ST_X(p.geom) order by p.path[1]) as eastings_m,
    array_agg(ST_Y(p.geom) order by p.path[1]) as northings_m
from conetl.active_drive d
join conetl.map m using (map_id)
cross join lateral (
    select ST_Simplify(ST_MakeLine(ST_Force2D(f.geom) order by f.frame_index), %(tolerance_m)s::float8) as line
    from conetl.frame_pair f
    where f.drive_uuid = d.drive_uuid
) l
cross join lateral ST_DumpPoints(l.line) p
where m.map_name = %(map_name)s and lower(d.captured_period) <= %(valid_until)s::timestamptz
and ST_NPoints(l.line) > 1
group by d.drive_uuid, d.drive_id, d.captured_from_ns
order by d.captured_from_ns, d.drive_id;
