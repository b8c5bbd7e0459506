-- Purpose: watched drives of a map that a new watch may replace: of the same drive, without an end, or long past.
-- Parameters: map_name, drive_id, keep_days. Columns: watch_id, drive_id.
select w.watch_id, w.drive_id
from conetl.watched_drive w
where w.map_name = %(map_name)s
and (w.drive_id = %(drive_id)s or w.ended_at is null or w.updated_at < now() - make_interval(days => %(keep_days)s));
