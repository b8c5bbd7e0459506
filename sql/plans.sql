-- Plans of work zones, people's verdicts on differences, and where drives looked.

-- name: plans
-- The plans of a map as the database knew them. Parameters: map_name; list_name (null: all); known_at (timestamptz, 'infinity': now).
-- Columns: list_name, plan_id, record (as PlannedZone), geom (well-known binary, map CRS), file_name, known_from.
select p.list_name, p.plan_id, p.record, ST_AsBinary(p.geom) as geom, p.file_name, lower(p.system_period) as known_from
from conetl.plan p
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and (%(list_name)s::text is null or p.list_name = %(list_name)s)
and p.system_period @> %(known_at)s::timestamptz
order by p.list_name, p.plan_id;

-- name: end_plans
-- End the current versions of plans. Parameters: map_id; list_name; plan_ids (text[]); at.
update conetl.plan set system_period = tstzrange(lower(system_period), %(at)s::timestamptz)
where map_id = %(map_id)s and list_name = %(list_name)s and plan_id = any(%(plan_ids)s::text[]) and upper_inf(system_period);

-- name: verdicts
-- Verdicts on a map's differences, the last one first. Parameters: map_name; known_at ('infinity': now).
select v.difference, v.verdict, v.note, v.decided_by
from conetl.plan_verdict v
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and v.decided_at <= %(known_at)s::timestamptz
order by v.verdict_no desc;

-- name: insert_verdict
-- What a person says about a difference. Parameters: as the columns.
insert into conetl.plan_verdict (map_id, difference, verdict, note, decided_by, decided_at)
values (%(map_id)s, %(difference)s::jsonb, %(verdict)s, %(note)s, %(decided_by)s, %(decided_at)s);

-- name: frames_near
-- The frame pairs in an area that show absence, of the active drives. Parameters: map_name; area (well-known binary, map CRS); until_ns;
-- least_detail (grey levels). Columns: drive_uuid, drive_id, frame_index, captured_at_ns, easting_m, northing_m.
select d.drive_uuid, d.drive_id, f.frame_index, f.captured_at_ns, ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m
from conetl.map m
cross join lateral (select ST_GeomFromWKB(%(area)s, m.srid) as geom) a
join conetl.active_drive d on d.map_id = m.map_id
join conetl.frame_pair f on f.drive_uuid = d.drive_uuid
where m.map_name = %(map_name)s and ST_SRID(d.area) = m.srid and d.area && a.geom
and f.captured_at_ns <= %(until_ns)s and coalesce(f.detail, 'infinity') >= %(least_detail)s
and ST_Intersects(a.geom, f.geom)
order by d.drive_uuid, f.frame_index;

-- name: images
-- The left images of frame pairs. Parameters: drive_uuids (uuid[]), frames (integer[]).
-- Columns: drive_uuid, frame_index, source_path (of the drive), left_path (in it).
select f.drive_uuid, f.frame_index, d.source_path, f.left_path
from unnest(%(drive_uuids)s::uuid[], %(frames)s::integer[]) as q (drive_uuid, frame_index)
join conetl.frame_pair f on f.drive_uuid = q.drive_uuid and f.frame_index = q.frame_index
join conetl.drive d on d.drive_uuid = f.drive_uuid;
