-- Purpose: which of some drives have no raw records any more. Parameters: drive_uuids (uuid[]).
-- Columns: drive_id, captured_to, pruned_at (timestamptz).
select d.drive_id, upper(d.captured_period) as captured_to, d.pruned_at
from conetl.drive d
where d.drive_uuid = any(%(drive_uuids)s) and d.pruned_at is not null
order by d.captured_from_ns;
