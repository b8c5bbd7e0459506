-- Purpose: every changeset holds as many deltas and records as it says (deltas as it was committed, not as played again since; of a
-- pruned drive no detections, stereo matches and positions).
-- Columns: changeset_id, what, stated, found, problem.
with delta_counts as (
    select
        x.changeset_id,
        count(*) filter (where x.kind = 'added') as added,
        count(*) filter (where x.kind = 'confirmed') as confirmed,
        count(*) filter (where x.kind = 'moved') as moved,
        count(*) filter (where x.kind = 'removed') as removed,
        count(*) filter (where x.kind = 'missed') as missed,
        count(*) filter (where x.kind = 'height_changed') as height_changed,
        count(*) filter (where x.kind = 'split') as split,
        count(*) filter (where x.kind = 'merged') as merged
    from conetl.delta x
    join conetl.changeset c on c.changeset_id = x.changeset_id and c.committed_at = lower(x.system_period)
    group by x.changeset_id
)
select c.changeset_id, counted.what, counted.stated, counted.found, 'the numbers differ' as problem
from conetl.changeset c
join conetl.drive d using (drive_uuid)
left join delta_counts x on x.changeset_id = c.changeset_id
cross join lateral (
    values
        ('added', c.added_count, coalesce(x.added, 0)),
        ('confirmed', c.confirmed_count, coalesce(x.confirmed, 0)),
        ('moved', c.moved_count, coalesce(x.moved, 0)),
        ('removed', c.removed_count, coalesce(x.removed, 0)),
        ('missed', c.missed_count, coalesce(x.missed, 0)),
        ('height changed', c.height_changed_count, coalesce(x.height_changed, 0)),
        ('split', c.split_count, coalesce(x.split, 0)),
        ('merged', c.merged_count, coalesce(x.merged, 0)),
        ('frame pairs', c.frame_pair_count, (select count(*) from conetl.frame_pair r where r.drive_uuid = c.drive_uuid)),
        ('detections', case when d.pruned_at is null then c.detection_count else 0 end,
            (select count(*) from conetl.detection r where r.drive_uuid = c.drive_uuid)),
        ('stereo matches', case when d.pruned_at is null then c.match_count else 0 end,
            (select count(*) from conetl.stereo_match r where r.drive_uuid = c.drive_uuid)),
        ('positions', case when d.pruned_at is null then c.position_count else 0 end,
            (select count(*) from conetl.position r where r.drive_uuid = c.drive_uuid)),
        ('tracks', c.track_count, (select count(*) from conetl.track r where r.drive_uuid = c.drive_uuid)),
        ('rejections', c.rejection_count, (select count(*) from conetl.quarantine r where r.changeset_id = c.changeset_id))
) counted (what, stated, found)
where counted.stated <> counted.found;
