-- Purpose: a drive has come onto the map: what was shown of it while it was recorded goes. Parameters: map_name, drive_id,
-- captured_from_ns, captured_to_ns (UTC ns): another recording of the same name is left alone.
delete from conetl.watched_drive
where map_name = %(map_name)s and drive_id = %(drive_id)s
and captured_from_ns <= %(captured_to_ns)s and captured_to_ns >= %(captured_from_ns)s;
