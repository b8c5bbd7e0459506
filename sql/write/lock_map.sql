-- Purpose: let only one transaction at a time read and change this map; held until the transaction ends.
-- Parameters: map_name.
select pg_advisory_xact_lock(hashtextextended('conetl.map/' || %(map_name)s, 0));
