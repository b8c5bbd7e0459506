-- The stored overview of the maps as they are now, and the same of any other state.

create or replace function conetl.cell_zooms() returns setof integer
language sql immutable rows 5
as $$
    select generate_series(4, 12, 2)
$$;
comment on function conetl.cell_zooms is 'Zooms of conetl.feature_cell: cells of 65 km, 16 km, 4 km, 1 km and 256 m.';

create or replace function conetl.count_cells() returns trigger
language plpgsql
as $$
declare
    source text;
    sign integer;
begin
    if tg_op = 'TRUNCATE' then
        delete from conetl.feature_cell;
        return null;
    end if;
    for source, sign in
        select s.name, s.sign
        from (values ('written', 1, 'DELETE'), ('gone', -1, 'INSERT')) s (name, sign, without)
        where s.without <> tg_op
    loop
        execute format(
            'insert into conetl.feature_cell as c (map_id, zoom, x, y, category, is_line, feature_count, sum_cm)
            select
                v.map_id, z, floor(ST_X(v.geom) / 2 ^ (20 - z)), floor(ST_Y(v.geom) / 2 ^ (20 - z)), v.category, v.line is not null,
                %2$s * count(*),
                array[
                    %2$s * sum(round(ST_X(v.geom) * 100)), %2$s * sum(round(ST_Y(v.geom) * 100)), %2$s * sum(round(ST_Z(v.geom) * 100))
                ]::bigint[]
            from %1$I v
            cross join conetl.cell_zooms() z
            where v.present and upper_inf(v.system_period) and upper_inf(v.valid_period)
            group by 1, 2, 3, 4, 5, 6
            order by 1, 2, 3, 4, 5, 6
            on conflict (map_id, zoom, x, y, category, is_line) do update
            set feature_count = c.feature_count + excluded.feature_count,
                sum_cm = array[c.sum_cm[1] + excluded.sum_cm[1], c.sum_cm[2] + excluded.sum_cm[2], c.sum_cm[3] + excluded.sum_cm[3]]',
            source, sign
        );
    end loop;
    if tg_op <> 'INSERT' then
        delete from conetl.feature_cell c
        where c.map_id in (select distinct g.map_id from gone g) and c.feature_count = 0;
    end if;
    return null;
end
$$;
comment on function conetl.count_cells is 'Trigger: conetl.feature_cell follows conetl.feature_version.';

create or replace function conetl.is_now(map_name text, valid_at timestamptz, known_at timestamptz) returns boolean
language sql stable
as $$
    select
        not exists (select from conetl.changeset c where c.map_id = m.map_id and c.committed_at > $3)
        and not exists (select from conetl.decision d where d.map_id = m.map_id and d.decided_at > $3)
        and not exists (select from conetl.drive d where d.map_id = m.map_id and upper(d.captured_period) > $2)
    from conetl.map m
    where m.map_name = $1
$$;
comment on function conetl.is_now is 'Whether the state of a map at valid_at on the road, as known at known_at, is that of now.';
