-- Cells, areas and lines. The files of this folder are applied in the order of their names after the migrations, whenever one of
-- them has changed; what they replace, and what it returned before, is dropped by a migration.

-- South to north in rows of cells, west to east within a row. Numbers beyond all maps are cut off instead of being rejected here.
create or replace function conetl.cell_at(point geometry) returns bigint
language sql immutable strict parallel safe
as $$
    select
        (least(greatest(floor(ST_Y(point) / 256), -1073741824), 1073741824)::bigint << 32)
        + least(greatest(floor(ST_X(point) / 256), -1073741824), 1073741824)::bigint
$$;
comment on function conetl.cell_at is 'The square of 256 m (map CRS) around a point, as one number; neighbours have near numbers.';

create or replace function conetl.offset_m(place geometry, origin_m float8[]) returns float8[]
language sql immutable parallel safe
as $$
    select case when place is not null then array[
        round((ST_X(place) - origin_m[1]) * 1e4) / 1e4, round((ST_Y(place) - origin_m[2]) * 1e4) / 1e4,
        round((ST_Z(place) - origin_m[3]) * 1e4) / 1e4
    ] end
$$;
comment on function conetl.offset_m is 'Easting, northing and height of a point counted from an origin (metres, to 0.1 mm).';

create or replace function conetl.cell_of(feature_id uuid) returns bigint
language sql stable parallel safe
as $$
    select f.cell from conetl.feature f where f.feature_id = $1 and f.map_id > 0
$$;
comment on function conetl.cell_of is 'The cell in which a feature was created, which keys begin with; null where there is no such feature.';

-- Features around an oblique road: the box around its whole area may hold a hundred times as much. Pieces are cut by number of vertices,
-- so a straight road gets some first: a piece is at most about 1.5 km of it.
create or replace function conetl.pieces(area geometry) returns setof geometry
language sql immutable parallel safe rows 1
as $$
    select area where 4 * ST_Area(area) >= ST_Area(ST_Envelope(area))
    union all
    select p.piece from ST_Subdivide(ST_Segmentize(area, 50), 64) p (piece) where 4 * ST_Area(area) < ST_Area(ST_Envelope(area))
$$;
comment on function conetl.pieces is
    'An area, subdivided where its bounding box is more than four times as large, for indexes on boxes. Pieces share their edges.';

create or replace function conetl.lateral_sigma_m(line geometry, line_cov float8[]) returns float8
language sql immutable strict
as $$
    select sqrt(max(
        ((b.y - a.y) ^ 2 * line_cov[n.i][1] - 2 * (b.y - a.y) * (b.x - a.x) * line_cov[n.i][2] + (b.x - a.x) ^ 2 * line_cov[n.i][4])
        / ((b.x - a.x) ^ 2 + (b.y - a.y) ^ 2)
    ))
    from generate_series(1, ST_NPoints(line)) n (i)
    cross join lateral (select ST_PointN(line, greatest(n.i - 1, 1)) as p) before
    cross join lateral (select ST_PointN(line, least(n.i + 1, ST_NPoints(line))) as p) after
    cross join lateral (select ST_X(before.p) as x, ST_Y(before.p) as y) a
    cross join lateral (select ST_X(after.p) as x, ST_Y(after.p) as y) b
    where (b.x, b.y) <> (a.x, a.y)
$$;
comment on function conetl.lateral_sigma_m is
    'Largest standard deviation across a line (m): of the vertex with the largest one, at right angles to the line there.';

-- A lock per map, until the end of the transaction, makes whoever else writes versions of the map wait: each then sees the rows of the
-- other (read committed). Transactions of conetl are one after the other there anyway. Sequential scans are off, because the plan is kept
-- for the session, in which the table may grow from nothing.
create or replace function conetl.refuse_overlaps() returns trigger
language plpgsql
set enable_seqscan = off
as $$
declare
    twice uuid;
begin
    perform pg_advisory_xact_lock(hashtextextended('conetl.versions/' || m.map_id, 0))
    from (select distinct w.map_id from written w order by 1) m;
    select w.feature_id into twice
    from written w
    cross join lateral (
        select v.version_row_id, v.valid_period
        from conetl.feature_version v
        where v.cell = w.cell and v.feature_id = w.feature_id and coalesce(upper(v.system_period), 'infinity') = 'infinity'
        offset 0
    ) v
    where upper_inf(w.system_period) and v.valid_period && w.valid_period and v.version_row_id <> w.version_row_id
    limit 1;
    if found then
        raise exclusion_violation using
            message = format('two current versions of feature %s are valid at the same time (no_overlap)', twice),
            constraint = 'no_overlap';
    end if;
    return null;
end
$$;
comment on function conetl.refuse_overlaps is 'Trigger: no two current versions of a feature are valid at the same time.';
