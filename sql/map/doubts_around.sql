-- Purpose: what drives that looked in vain make of the features that stand around a drive's path, as the map knows them now.
-- Parameters: drive_uuid. Columns: feature_id, existence_probability (after the latest of them), first_missed_ns (the earliest).
-- around is materialized: beginning with the deltas, the planner would cut the drive's area up once for each of them.
with around as materialized (
    select v.cell, v.feature_id, v.version
    from conetl.drive d
    cross join lateral conetl.pieces(d.area) piece
    join conetl.feature_version v on v.map_id = d.map_id and v.geom && piece and ST_Intersects(v.geom, piece)
    where d.drive_uuid = %(drive_uuid)s
    and upper_inf(v.system_period) and upper_inf(v.valid_period) and (v.present or v.suppressed)
)
select
    v.feature_id,
    (
        array_agg(
            x.existence_after
            order by m.captured_from_ns desc, m.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
        )
    )[1],
    min(x.changed_at_ns)
from around v
join conetl.delta x on x.cell = v.cell and x.feature_id = v.feature_id and x.old_version = v.version
join conetl.changeset c on c.changeset_id = x.changeset_id
join conetl.drive m on m.drive_uuid = c.drive_uuid
where x.kind = 'missed' and upper_inf(x.system_period)
group by v.feature_id
order by v.feature_id;
