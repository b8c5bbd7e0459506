-- How many features stand in each cell of the map now: the overview of a large map is read from here. It follows from
-- conetl.feature_version, is written by triggers of it, whatever changes it (merge, replay, decision, restore, deletion), and is not
-- part of a map's dump.

create table conetl.feature_cell (
    map_id        integer not null,
    zoom          smallint not null,
    x             integer not null,
    y             integer not null,
    category      text not null,
    is_line       boolean not null,
    feature_count integer not null,
    sum_cm        bigint[] not null,
    primary key (map_id, zoom, x, y, category, is_line)
);
create index feature_cell_empty on conetl.feature_cell (map_id) where feature_count = 0;
comment on table conetl.feature_cell is
    'Number of features that stand now, as known now, by cell and class: squares of 2^(20 - zoom) m of the map''s CRS from its origin on, '
    'for the zooms of conetl.cell_zooms(). A lane marking stands at its middle vertex.';
comment on column conetl.feature_cell.sum_cm is 'Sums of easting, northing and height (whole centimetres), for the mean position.';

create function conetl.cell_zooms() returns setof integer
language sql immutable
as $$
    select generate_series(4, 12, 2)
$$;

create function conetl.count_cells() returns trigger
language plpgsql
as $$
begin
    return null;
end
$$;

create trigger sum_by_cell after insert on conetl.feature_version
referencing new table as written for each statement execute function conetl.count_cells();
create trigger sum_by_cell_of_changed after update on conetl.feature_version
referencing old table as gone new table as written for each statement execute function conetl.count_cells();
create trigger sum_by_cell_of_deleted after delete on conetl.feature_version
referencing old table as gone for each statement execute function conetl.count_cells();
create trigger sum_by_cell_of_none after truncate on conetl.feature_version
for each statement execute function conetl.count_cells();

insert into conetl.feature_cell (map_id, zoom, x, y, category, is_line, feature_count, sum_cm)
select
    v.map_id, z, floor(ST_X(v.geom) / 2 ^ (20 - z)), floor(ST_Y(v.geom) / 2 ^ (20 - z)), v.category, v.line is not null, count(*),
    array[sum(round(ST_X(v.geom) * 100)), sum(round(ST_Y(v.geom) * 100)), sum(round(ST_Z(v.geom) * 100))]::bigint[]
from conetl.feature_version v
cross join conetl.cell_zooms() z
where v.present and upper_inf(v.system_period) and upper_inf(v.valid_period)
group by 1, 2, 3, 4, 5, 6;
