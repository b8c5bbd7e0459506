-- Purpose: say that a watched drive has ended; its provisional features stay until it is ingested. Parameters: watch_id.
update conetl.watched_drive set ended_at = clock_timestamp() where watch_id = %(watch_id)s;
