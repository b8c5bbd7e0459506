-- Purpose: one page of features of a map as GeoJSON, made by PostgreSQL: nobody unpacks the items on their way to the client.
-- Parameters: $1 limit, $2 offset; $3, $4 what stands before and behind the id in the links of each item; $5 map name; $6, $7, $8 from_at,
-- to_at, known_at (text of instants); then those of the box, or nothing for all of the map, or the rows of versions that {{where}} names.
-- Put in by the caller: {{source}} (conetl_ogc.standing; conetl_ogc.features where the condition or the order needs its evidence), {{box}} (named
-- arguments of it, each after a comma), {{where}}, {{order}}, {{properties}} (columns of p, n and e).
-- Columns: items (with commas, in order; null: none), returned (how many).
-- Evidence is that of conetl.feature_evidence, looked up after the limit and for all items at once; belief after a miss only where there is
-- one. The full join finds what a left join would, because n has no other features; but it is always hashed or merged, where a planner who
-- expects one item would go through n once for each.
with page as materialized (
    select s.*, row_number() over () as place_no
    from (
        select *
        from {{source}}($5, $6::text::timestamptz, $7::text::timestamptz, $8::text::timestamptz{{box}})
        {{where}}
        order by {{order}}
        limit $1 offset $2
    ) s
)
select
    string_agg(
        '{"type":"Feature","geometry":' || ST_AsGeoJSON(p.geom) || ',"id":"' || p.feature_id
        || '","properties":' || row_to_json(r) || ',"links":' || $3::text || p.feature_id || $4::text || '}',
        ',' order by p.place_no
    ) as items,
    count(*)::integer as returned
from page p
full join (
    select
        x.feature_id,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer as missed_count,
        count(*) filter (
            where x.kind not in ('missed', 'removed', 'merged') and x.changeset_id not in (
                select i.changeset_id from conetl.drive d join conetl.changeset i using (drive_uuid) where d.kind <> 'drive'
            )
        )::integer as seen_count
    from page p
    join conetl.feature f on f.feature_id = p.feature_id and f.map_id > 0
    join conetl.delta x on x.cell = f.cell and x.feature_id = f.feature_id
    where x.changed_at <= (select $7::text::timestamptz) and x.system_period @> (select $8::text::timestamptz)
    group by x.feature_id
) n on n.feature_id = p.feature_id
cross join lateral (
    select
        case when n.missed_count > 0 then (
            select x.existence_after
            from conetl.delta x
            join conetl.changeset c using (changeset_id)
            join conetl.drive d using (drive_uuid)
            where x.cell = conetl.cell_of(p.feature_id) and x.feature_id = p.feature_id and x.old_version = p.version and x.kind = 'missed'
            and x.changed_at <= (select $7::text::timestamptz) and x.system_period @> (select $8::text::timestamptz)
            order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            limit 1
        ) end as existence_after
) e
cross join lateral (select {{properties}}) r;
