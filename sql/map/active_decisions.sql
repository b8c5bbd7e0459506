-- Purpose: what people decided about a map and did not take back, oldest first. Parameters: map_name.
-- Columns: decision_id, decision_no, kind, easting_m, northing_m, radius_m, feature_id, changeset_id, note, decided_by,
-- decided_at.
select
    d.decision_id, d.decision_no, d.kind, ST_X(d.geom) as easting_m, ST_Y(d.geom) as northing_m, d.radius_m, d.feature_id,
    d.changeset_id, d.note, d.decided_by, d.decided_at
from conetl.active_decision d
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by d.decision_no;
