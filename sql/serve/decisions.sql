-- Purpose: what people decided about a map and did not take back, newest first. Parameters: map_name; max_rows.
-- Columns: decision_id, kind ('suppress', 'pin', 'revert'), easting_m, northing_m, radius_m (null but for places), feature_id,
-- changeset_id, drive_id (of a reverted changeset), decided_by (null: kept no name), note, decided_at.
select
    d.decision_id, d.kind, ST_X(d.geom) as easting_m, ST_Y(d.geom) as northing_m, d.radius_m, d.feature_id, d.changeset_id,
    r.drive_id, d.decided_by, d.note, d.decided_at
from conetl.active_decision d
join conetl.map m using (map_id)
left join conetl.changeset c on c.changeset_id = d.changeset_id
left join conetl.drive r on r.drive_uuid = c.drive_uuid
where m.map_name = %(map_name)s
order by d.decision_no desc
limit %(max_rows)s;
