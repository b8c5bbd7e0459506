-- Lists of the web view: features and changes by pages, filtered and sorted here, and changes by what is in view.
--
-- Each statement but the first three reads rows of one of these, {{source}}, with the conditions {{where}} about s.

-- name: standing
-- The features of a map now: all that lists filter and sort by is in the index feature_version_now. Parameters: map_name.
-- Columns: kind, shift_m, changed_at, old_row_id; judged_by (the changeset, if it is not that of the state); those of
-- conetl.feature_state that lists have. Where changeset_no is not read, changesets are not either.
select
    'standing' as kind, null::float8 as shift_m, null::timestamptz as changed_at, null::bigint as old_row_id, null::bigint as judged_by,
    v.version_row_id, v.cell, v.feature_id, v.category, v.existence_probability, v.observation_count, {{sigma columns of v}} as sigma_m,
    case when v.category <> 'lane_marking' then v.object_height_m end as object_height_m,
    timestamptz 'epoch' + v.last_seen_ns / 1000 * interval '1 microsecond' as last_seen_at, c.changeset_no, v.geom
from conetl.feature_version v
left join conetl.changeset c using (changeset_id)
where v.map_id = (select m.map_id from conetl.map m where m.map_name = %(map_name)s)
and v.present and upper_inf(v.system_period) and upper_inf(v.valid_period);

-- name: stood
-- The features of any state. Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest). Columns: as standing.
select
    'standing' as kind, null::float8 as shift_m, null::timestamptz as changed_at, null::bigint as old_row_id, null::bigint as judged_by,
    s.version_row_id, s.cell, s.feature_id, s.category, s.existence_probability, s.observation_count, s.sigma_m, s.object_height_m,
    s.last_seen_at, s.changeset_no, s.geom
from conetl.feature_states(%(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) s;

-- name: changed_by
-- What a changeset did to each feature that it judged. Parameters: map_name; changeset_no; box (geometry; null: everywhere).
-- Columns: kind, changed_at, shift_m; old_row_id (before a move); those of the state after the change, of a removed feature the last one.
select x.*, %(changeset_no)s as changeset_no, %(changeset_no)s as judged_by
from conetl.changeset_changes(%(map_name)s, %(changeset_no)s, %(box)s::geometry) x;

-- name: changed_between
-- How a map differs between two instants, each as known at its own. Parameters: map_name; from_valid_at, from_known_at, to_valid_at,
-- to_known_at (timestamptz; 'infinity' = latest); box (geometry; null: everywhere). Columns: as changed_by.
-- offset 0: the planner expects few changes in a box, and would read all features of the box anew for each.
select
    c.change as kind, c.shift_m, c.changed_at, case when c.change = 'moved' then c.old_row_id end as old_row_id,
    null::bigint as judged_by, s.*
from conetl.feature_changes(
    %(map_name)s, %(from_valid_at)s::timestamptz, %(to_valid_at)s::timestamptz, %(to_known_at)s::timestamptz,
    %(from_known_at)s::timestamptz, %(box)s::geometry
) c
cross join lateral (
    select
        f.version_row_id, f.cell, f.feature_id, f.category, f.existence_probability, f.sigma_m, f.object_height_m, f.last_seen_at,
        f.observation_count, f.changeset_no, f.geom
    from conetl.feature_state f
    where f.version_row_id = c.version_row_id
    offset 0
) s;

-- name: page
-- One page, in order. Parameters: those of the source and the conditions; page_rows, offset_rows; origin_m, from which positions count.
-- Placeholders: {{key}} (what it is sorted by), {{direction}}. Columns: key; row_id; of conetl.feature_state; kind, changed_at, shift_m, old_xyz_m.
with page as materialized (
    select
        s.version_row_id, {{key}} as key, s.kind, s.shift_m, s.changed_at, s.old_row_id, s.existence_probability, s.judged_by
    from ({{source}}) s
    where {{where}}
    order by 2 {{direction}}, s.version_row_id
    limit %(page_rows)s offset %(offset_rows)s
)
select
    p.key, p.version_row_id as row_id, p.kind, p.shift_m, p.changed_at, conetl.offset_m(o.geom, %(origin_m)s::float8[]) as old_xyz_m,
    p.existence_probability, coalesce(p.judged_by, s.changeset_no) as changeset_no, s.feature_id, s.version, s.category, s.sigma_m,
    s.object_height_m, s.last_seen_at, s.observation_count, conetl.offset_m(s.geom, %(origin_m)s::float8[]) as xyz_m
from page p
join conetl.feature_state s using (version_row_id)
left join conetl.feature_state o on o.version_row_id = p.old_row_id
order by p.key {{direction}}, p.version_row_id;

-- name: count
-- Number of rows, and of those before one of them in an order. Parameters: as page. Placeholders: {{before}} (condition).
-- Columns: row_count, before_count.
select count(*) as row_count, count(*) filter (where {{before}}) as before_count
from ({{source}}) s
where {{where}};

-- name: sorted_by
-- The key of one feature, if it is in the list. Parameters: feature_id. Placeholders: as page. Columns: key, row_id.
select {{key}} as key, s.version_row_id as row_id
from ({{source}}) s
where s.cell = conetl.cell_of(%(feature_id)s) and s.feature_id = %(feature_id)s and {{where}};

-- name: summary
-- Numbers by kind and class. Columns: kind; category; row_count.
select s.kind, s.category, count(*) as row_count
from ({{source}}) s
where {{where}}
group by s.kind, s.category;

-- name: cells
-- Numbers by square of 2^(20 - cell_zoom) m and kind. Parameters: cell_zoom. Columns: x, y, kind; feature_count, sum_cm as in
-- conetl.feature_cell.
select
    floor(ST_X(s.geom) / 2 ^ (20 - %(cell_zoom)s))::bigint as x, floor(ST_Y(s.geom) / 2 ^ (20 - %(cell_zoom)s))::bigint as y,
    s.kind, count(*) as feature_count,
    array[sum(round(ST_X(s.geom) * 100)), sum(round(ST_Y(s.geom) * 100)), sum(round(ST_Z(s.geom) * 100))]::bigint[] as sum_cm
from ({{source}}) s
where {{where}}
group by 1, 2, 3;

-- name: drawn
-- Changes with what the view shows of them. Parameters: origin_m. Columns: of conetl.feature_state; kind, changed_at, shift_m, old_xyz_m;
-- marking, old_marking: shape of a lane marking, null of point objects.
with found as materialized (
    select s.* from ({{source}}) s where {{where}}
)
select
    c.kind, c.changed_at, c.shift_m, conetl.offset_m(o.geom, %(origin_m)s::float8[]) as old_xyz_m, c.existence_probability,
    c.changeset_no, s.feature_id, s.version, s.category, s.sigma_m, s.object_height_m, s.last_seen_at, s.observation_count,
    conetl.offset_m(s.geom, %(origin_m)s::float8[]) as xyz_m, {{marking columns of s}} as marking, {{marking columns of o}} as old_marking
from found c
join conetl.feature_state s using (version_row_id)
left join conetl.feature_state o on o.version_row_id = c.old_row_id
order by s.feature_id;
