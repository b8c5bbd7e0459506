-- Purpose: delete the raw records of some drives by policy. Parameters: drive_uuids (uuid[]).
delete from conetl.stereo_match r
where r.drive_uuid = any(%(drive_uuids)s);
