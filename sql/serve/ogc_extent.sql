-- Purpose: where and from when on a map holds something. Parameters: $1 map name.
-- Columns: west, south, east, north (degrees; around all that drives looked at), since (beginning of the first drive), share (of this map in
-- all versions of features of the database), version_count (of this map): both as PostgreSQL last estimated them for its plans, 0 where it
-- did not yet.
select
    ST_XMin(a.box) as west, ST_YMin(a.box) as south, ST_XMax(a.box) as east, ST_YMax(a.box) as north, a.since,
    coalesce(s.share, 0)::float8 as share, coalesce(s.share * s.row_count, 0)::float8 as version_count
from (
    select
        ST_Extent(ST_Transform(ST_Segmentize(e.edges, greatest(ST_Perimeter(e.edges) / 64, 1)), 4326)) as box,
        min(e.since) as since
    from (
        select ST_Envelope(d.area) as edges, lower(d.captured_period) as since
        from conetl.drive d
        join conetl.map m using (map_id)
        where m.map_name = $1
    ) e
) a
left join (
    select f.share, c.reltuples as row_count
    from conetl.map m
    join pg_class c on c.oid = 'conetl.feature_version'::regclass
    join pg_stats p on p.schemaname = 'conetl' and p.tablename = 'feature_version' and p.attname = 'map_id'
    join unnest(p.most_common_vals::text::integer[], p.most_common_freqs) f (map_id, share) using (map_id)
    where m.map_name = $1
) s on true;
