-- Purpose: the last drive, recorded before another one, that saw a feature. Parameters: feature_id, before_ns (UTC ns).
-- Columns: drive_uuid, track_index, drive_id, captured_from_ns.
select d.drive_uuid, x.track_index, d.drive_id, d.captured_from_ns
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and x.track_index is not null and upper_inf(x.system_period)
and d.kind = 'drive' and d.captured_from_ns < %(before_ns)s
order by d.captured_from_ns desc, c.changeset_no desc
limit 1;
