-- Purpose: the system time of a new changeset: later than every earlier one of the map, even when the clock was set back.
-- Parameters: now (timestamptz, null: the server's clock), last_committed_at (timestamptz or null). Columns: committed_at.
select greatest(
    coalesce(%(now)s::timestamptz, clock_timestamp()),
    %(last_committed_at)s::timestamptz + interval '1 microsecond'
) as committed_at;
