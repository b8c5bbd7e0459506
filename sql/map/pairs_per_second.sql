-- Purpose: how fast drives were on the map of late: the median of the last 200 that were committed.
-- Parameters: map_name. Columns: pairs_per_second (null: none was timed), drives.
select
    percentile_cont(0.5) within group (order by timed.frame_pairs / timed.seconds) as pairs_per_second,
    count(*) as drives
from (
    select r.frame_pairs, r.seconds
    from conetl.receipt r
    where r.map_name = %(map_name)s and r.state = 'committed' and r.seconds > 0 and r.frame_pairs > 0
    order by r.receipt_no desc
    limit 200
) as timed;
