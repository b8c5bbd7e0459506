-- Purpose: delete the raw records of some drives by policy. Parameters: drive_uuids (uuid[]).
delete from conetl.detection r
where r.drive_uuid = any(%(drive_uuids)s);
