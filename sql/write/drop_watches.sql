-- Purpose: remove watched drives with their provisional features. Parameters: watch_ids (uuid[]).
delete from conetl.watched_drive where watch_id = any(%(watch_ids)s::uuid[]);
