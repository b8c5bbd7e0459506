-- Purpose: the analysis of the same recording that counts now, other than this drive; it gives way to it.
-- Parameters: drive_uuid. Columns: drive_uuid.
select other.drive_uuid
from conetl.drive d
join conetl.active_drive other on other.map_id = d.map_id and other.content_sha256 = d.content_sha256
where d.drive_uuid = %(drive_uuid)s and other.drive_uuid <> d.drive_uuid;
