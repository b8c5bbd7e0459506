-- Purpose: drives whose last receipt of a span is no success, and those whose work was begun and not ended, oldest first.
-- Parameters: map_name, since, until. Columns: drive_id, drive_path, state (failed, crashed, started), reason, at, host, frame_pairs,
-- attempts (in the span).
with last_word as (
    select distinct on (r.header_sha256) r.*
    from conetl.receipt r
    where r.map_name = %(map_name)s and r.at >= %(since)s and r.at < %(until)s
    order by r.header_sha256, r.receipt_no desc
)

select
    w.drive_id, w.drive_path, w.state, w.reason, w.at, w.host, w.frame_pairs,
    (
        select count(*) from conetl.receipt s
        where s.map_name = w.map_name and s.header_sha256 = w.header_sha256 and s.state = 'started'
        and s.at >= %(since)s and s.at < %(until)s
    ) as attempts
from last_word w
where w.state in ('failed', 'crashed', 'started')
order by w.receipt_no;
