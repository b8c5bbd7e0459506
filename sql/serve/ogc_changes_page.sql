-- Purpose: one page of changes of a map as GeoJSON, made by PostgreSQL: nobody unpacks the items on their way to the client.
-- Parameters: $1 limit, $2 offset; $3, $4 what stands before and behind the id in the links of each item; $5 map name; $6, $7, $8, $9 from_at,
-- known_from, to_at, known_to (text of instants); $10 moved_from_m (m); then the box in both forms, as conetl_ogc.changes takes them, or
-- nothing for all of the map.
-- Put in by the caller: {{box}} (named arguments, each after a comma), {{where}}, {{order}}, {{properties}} (columns of p).
-- Columns: items (with commas, in order; null: none), returned (how many).
with page as materialized (
    select s.*, row_number() over () as place_no
    from (
        select *
        from conetl_ogc.changes(
            $5, $6::text::timestamptz, $7::text::timestamptz, $8::text::timestamptz, $9::text::timestamptz, $10{{box}}
        )
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
cross join lateral (select {{properties}}) r;
