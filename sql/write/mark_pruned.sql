-- Purpose: remember that some drives have no raw records any more. Parameters: drive_uuids (uuid[]), pruned_at (timestamptz).
update conetl.drive d
set pruned_at = %(pruned_at)s
where d.drive_uuid = any(%(drive_uuids)s);
