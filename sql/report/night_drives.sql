-- Purpose: changesets of a map that were committed in a span, oldest first, with figures for a report. Parameters: map_name, since, until.
-- Columns: changeset_no, changeset_id, drive_id, kind (drive or import), captured_from_ns, committed_at, counts (false: reverted or
-- superseded), added_count ... rejection_count as in conetl.changeset, expected_frame_count, residual_px (median of its cones;
-- null without cones), sigma_m (median horizontal sigma of its cones), seconds (of its ingest; null where no receipt tells).
select
    c.changeset_no, c.changeset_id, d.drive_id, d.kind, d.captured_from_ns, c.committed_at,
    exists (select from conetl.active_drive a where a.changeset_id = c.changeset_id) as counts,
    c.added_count, c.confirmed_count, c.moved_count, c.removed_count, c.missed_count, c.height_changed_count, c.split_count,
    c.merged_count, c.frame_pair_count, c.position_count, c.track_count, c.rejection_count, d.expected_frame_count,
    t.residual_px, t.sigma_m,
    (
        select r.seconds from conetl.receipt r
        where r.changeset_id = c.changeset_id and r.state = 'committed'
        order by r.receipt_no
        limit 1
    ) as seconds
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
cross join lateral (
    select
        percentile_cont(0.5) within group (order by k.residual_rms_px) as residual_px,
        percentile_cont(0.5) within group (order by sqrt((k.cov_xx + k.cov_yy) / 2)) as sigma_m
    from conetl.track k
    where k.drive_uuid = c.drive_uuid
) t
where m.map_name = %(map_name)s and c.committed_at >= %(since)s and c.committed_at < %(until)s
order by c.changeset_no;
