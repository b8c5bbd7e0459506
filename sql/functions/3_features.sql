-- The read model: what stood there (feature_states), what differs (feature_changes), what each drive did (feature_delta).
--
-- Everything that shows the map selects from these, so that all faces give the same answer. They only read, and are plain queries of
-- one statement: PostgreSQL inlines them, so that a filter, an order or a limit outside reaches the tables inside, and a column that
-- is not asked for costs nothing. The columns are those of model/columns.py.

create or replace view conetl.feature_state as
select
    m.map_name, v.feature_id, v.version, v.category, v.existence_probability, v.observation_count, v.seen_count, v.missed_count,
    timestamptz 'epoch' + v.first_missed_ns / 1000 * interval '1 microsecond' as first_missed_at,
    case when v.line is null then v.object_height_m end as object_height_m,
    case when v.line is null then v.object_height_sigma_m end as object_height_sigma_m,
    sqrt(v.cov_xx) as sigma_e_m, sqrt(v.cov_yy) as sigma_n_m, sqrt(v.cov_zz) as sigma_u_m,
    sqrt((v.cov_xx + v.cov_yy) / 2 + sqrt(((v.cov_xx - v.cov_yy) / 2) ^ 2 + v.cov_xy ^ 2)) as sigma_m,
    v.cov_xy as cov_en_m2, v.cov_xz as cov_eu_m2, v.cov_yz as cov_nu_m2,
    v.width_m, v.width_sigma_m, v.colour, v.pattern, v.dash_m, v.gap_m,
    conetl.lateral_sigma_m(v.line, v.line_cov) as sigma_lateral_m, ST_3DLength(v.line) as length_m,
    timestamptz 'epoch' + v.first_seen_ns / 1000 * interval '1 microsecond' as first_seen_at,
    timestamptz 'epoch' + v.last_seen_ns / 1000 * interval '1 microsecond' as last_seen_at,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to,
    lower(v.system_period) as system_from, upper(v.system_period) as system_to,
    v.changeset_id, c.changeset_no::integer as changeset_no, d.drive_id, x.kind as change, x.shift_m, v.present, v.suppressed,
    ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as ellipsoidal_height_m,
    v.geom, v.line, v.valid_period, v.system_period, v.version_row_id, v.cell, v.map_id
from conetl.feature_version v
join conetl.map m using (map_id)
left join conetl.changeset c on c.changeset_id = v.changeset_id
left join conetl.drive d on d.drive_uuid = c.drive_uuid
cross join lateral (
    select
        (
            select k.kind from conetl.delta k
            where k.cell = v.cell and k.feature_id = v.feature_id and k.changeset_id = v.changeset_id
            and k.system_period @> lower(v.system_period)
        ) as kind,
        (
            select k.shift_m from conetl.delta k
            where k.cell = v.cell and k.feature_id = v.feature_id and k.changeset_id = v.changeset_id
            and k.system_period @> lower(v.system_period)
        ) as shift_m
) x;
comment on view conetl.feature_state is
    'Every state of every feature that the database ever held; valid_from to valid_to on the road, system_from to system_to in the '
    'database. A drive that did not observe a visible feature begins a new row of the same version. present: false where it was '
    'removed.';

create or replace function conetl.is_in_box(geom geometry, line geometry, box geometry) returns boolean
language sql immutable
as $$
    -- A line is found by its middle vertex, and is at most about 10 m long.
    select box is null or (geom && ST_Expand(box, 10) and coalesce(line, geom) && box)
$$;
comment on function conetl.is_in_box is 'Whether the box around a point object, or around a line with its middle vertex geom, meets a box; null: any.';

create or replace function conetl.feature_states(
    map_name text, valid_at timestamptz default 'infinity', known_at timestamptz default 'infinity', box geometry default null,
    since timestamptz default null
)
returns setof conetl.feature_state
language sql stable
as $$
    select s.*
    from conetl.feature_state s
    where s.map_name = $1 and s.present
    and s.valid_period && tstzrange(coalesce($5, $2), $2, '[]') and s.system_period @> $3
    and (
        $5 is null or not exists (
            select from conetl.feature_version later
            where later.cell = s.cell and later.feature_id = s.feature_id and later.present
            and later.valid_period && tstzrange($5, $2, '[]') and later.system_period @> $3
            and lower(later.valid_period) > lower(s.valid_period)
        )
    )
    and conetl.is_in_box(s.geom, s.line, $4)
$$;
comment on function conetl.feature_states is
    'What stood on a map at valid_at on the road, as known at known_at (infinity: latest). box: only features whose box meets it (map '
    'CRS). since: the last state of each feature that stood between since and valid_at.';

create or replace view conetl.current_feature as
select s.*
from conetl.feature_state s
where upper_inf(s.system_period) and upper_inf(s.valid_period) and s.present;
comment on view conetl.current_feature is 'The maps as they are now, as known now: one row per standing feature.';

create or replace function conetl.comparison(
    map_name text, known_at timestamptz, out moved_m float8, out line_moved_m float8, out height_m float8
)
language sql stable
as $$
    select
        (d.reconcile ->> 'min_gate_m')::float8, (d.reconcile ->> 'marking_gate_m')::float8,
        (d.reconcile ->> 'moved_height_tolerance_m')::float8
    from conetl.map m
    join conetl.changeset c using (map_id)
    join conetl.drive d using (drive_uuid)
    where m.map_name = $1 and c.committed_at <= $2
    order by c.changeset_no desc
    limit 1
$$;
comment on function conetl.comparison is
    'From which difference on a feature counts as moved (a lane marking: across its line) or as one of another height: parameters of '
    'the newest changeset at known_at.';

create or replace function conetl.either_state(
    map_name text, from_at timestamptz, to_at timestamptz, known_at timestamptz, known_from timestamptz
)
returns table (cell bigint, feature_id uuid, version_row_id bigint, is_later boolean)
language sql stable
as $$
    select v.cell, v.feature_id, v.version_row_id, v.valid_period @> $3 and v.system_period @> $4
    from conetl.feature_version v
    where v.map_id = (select m.map_id from conetl.map m where m.map_name = $1) and v.present
    and (v.valid_period @> $3 and v.system_period @> $4) <> (v.valid_period @> $2 and v.system_period @> coalesce($5, $4))
$$;
comment on function conetl.either_state is 'Rows of the features of a map that were true at one of two instants only; is_later: at to_at.';

create or replace function conetl.feature_changes(
    map_name text, from_at timestamptz default '-infinity', to_at timestamptz default 'infinity',
    known_at timestamptz default 'infinity', known_from timestamptz default null, box geometry default null
)
returns table (
    feature_id uuid, change text, changed_at timestamptz, shift_m float8, old_version integer, new_version integer,
    old_easting_m float8, old_northing_m float8, old_ellipsoidal_height_m float8, is_line boolean,
    version_row_id bigint, new_row_id bigint, old_row_id bigint
)
language sql stable
as $$
    select
        p.feature_id, k.change,
        case k.change
            when 'removed' then case when not g.suppressed then lower(g.valid_period) end
            when 'missed' then lower(n.valid_period)
            when 'confirmed' then case when n.first_missed_ns is null then lower(n.valid_period) else (
                select min(lower(v.valid_period)) from conetl.feature_version v
                where v.cell = n.cell and v.feature_id = n.feature_id and v.present and v.version = n.version
                and (v.valid_period @> $2 or lower(v.valid_period) between $2 and $3) and v.system_period @> $4
            ) end
            else (
                select min(lower(v.valid_period)) from conetl.feature_version v
                where v.cell = n.cell and v.feature_id = n.feature_id and v.present
                and (v.valid_period @> $2 or lower(v.valid_period) between $2 and $3) and v.system_period @> $4
                and case k.change
                    when 'moved' then ST_Distance(coalesce(o.line, o.geom), v.geom) > k.moved_m
                    when 'height_changed' then abs(v.object_height_m - o.object_height_m) > k.height_m
                    else true
                end
            )
        end,
        k.shift_m, o.version, n.version, ST_X(o.geom), ST_Y(o.geom), ST_Z(o.geom), coalesce(n.line, o.line) is not null,
        coalesce(p.new_row_id, g.version_row_id, p.old_row_id), p.new_row_id, p.old_row_id
    from (
        select
            w.cell, w.feature_id, max(w.version_row_id) filter (where w.is_later) as new_row_id,
            max(w.version_row_id) filter (where not w.is_later) as old_row_id
        from conetl.either_state($1, $2, $3, $4, $5) w
        where $6 is null
        group by w.cell, w.feature_id
        union all
        -- Of the features that ever were in the box: the other state may be outside.
        select w.cell, w.feature_id, max(w.version_row_id) filter (where w.is_later), max(w.version_row_id) filter (where not w.is_later)
        from (
            select distinct f.cell, f.feature_id from conetl.feature_version f where $6 is not null and conetl.is_in_box(f.geom, f.line, $6)
        ) near
        join conetl.either_state($1, $2, $3, $4, $5) w using (cell, feature_id)
        group by w.cell, w.feature_id
    ) p
    left join conetl.feature_version n on n.version_row_id = p.new_row_id
    left join conetl.feature_version o on o.version_row_id = p.old_row_id
    left join conetl.feature_version g on p.new_row_id is null and g.cell = o.cell and g.feature_id = o.feature_id and not g.present
        and g.valid_period @> $3 and g.system_period @> $4
    cross join (select * from conetl.comparison($1, $4) offset 0) limits
    cross join lateral (
        select
            ST_Distance(coalesce(o.line, o.geom), n.geom) as shift_m, limits.height_m,
            case when o.line is null then limits.moved_m else limits.line_moved_m end as moved_m
    ) l
    cross join lateral (
        select
            l.*,
            case
                when o.version_row_id is null then 'added'
                when n.version_row_id is null then 'removed'
                when l.shift_m > l.moved_m then 'moved'
                when n.line is null and abs(n.object_height_m - o.object_height_m) > l.height_m then 'height_changed'
                when n.version = o.version and n.seen_count = o.seen_count and n.missed_count > o.missed_count
                    and ST_OrderingEquals(n.geom, o.geom) then 'missed'
                else 'confirmed'
            end as change
    ) k
    where (conetl.is_in_box(n.geom, n.line, $6) or conetl.is_in_box(o.geom, o.line, $6))
    and (
        n.version_row_id is null or o.version_row_id is null
        or (n.version, n.category, n.existence_probability, n.observation_count, n.seen_count, n.missed_count, n.last_seen_ns)
        is distinct from (o.version, o.category, o.existence_probability, o.observation_count, o.seen_count, o.missed_count, o.last_seen_ns)
        or (n.cov_xx, n.cov_yy, n.cov_zz, n.object_height_m) is distinct from (o.cov_xx, o.cov_yy, o.cov_zz, o.object_height_m)
        or not ST_OrderingEquals(coalesce(n.line, n.geom), coalesce(o.line, o.geom))
    )
$$;
comment on function conetl.feature_changes is
    'How a map differs between two instants on the road, both as known at known_at (known_from: the earlier one as known then). change: '
    'added, removed, moved, height_changed, confirmed (the same place, newer values) or missed (a drive did not observe it, it still '
    'stands). version_row_id: of the later state (of a removed feature: the one that says that it is gone); join conetl.feature_state by it.';

create or replace view conetl.feature_delta as
select
    x.*, c.map_id, m.map_name, c.changeset_no, c.committed_at, d.drive_uuid, d.drive_id, d.kind as drive_kind, d.captured_from_ns,
    row(d.captured_from_ns, d.content_sha256, c.idempotency_key)::conetl.drive_order as drive_order
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid);
comment on view conetl.feature_delta is
    'What each drive, or imported map, did to each feature or observed of it, with its drive; drive_order: the order in which drives are '
    'compared with the map. Current where upper_inf(system_period).';

create or replace function conetl.state_after(
    cell bigint, feature_id uuid, version integer, changeset_id uuid, known_at timestamptz
)
returns setof conetl.feature_state
language sql stable rows 1
as $$
    select s.*
    from conetl.feature_state s
    where s.cell = $1 and s.feature_id = $2 and s.version = $3
    order by s.system_period @> $5 desc, s.changeset_id = $4 desc, s.version_row_id desc
    limit 1
$$;
comment on function conetl.state_after is
    'The state of a feature after the delta of a changeset that made or judged its version, as known at known_at, or last.';

create or replace function conetl.changeset_changes(map_name text, changeset_no bigint, box geometry default null)
returns table (
    kind text, changed_at timestamptz, shift_m float8, track_index integer, frames_seen integer, frames_empty integer,
    other_feature_id uuid, version_row_id bigint, old_row_id bigint, cell bigint, feature_id uuid, category text,
    existence_probability float8, sigma_m float8, object_height_m float8, last_seen_at timestamptz, observation_count integer,
    geom geometry
)
language sql stable
as $$
    select
        x.kind, x.changed_at, x.shift_m, x.track_index, x.frames_seen, x.frames_empty, x.other_feature_id,
        n.version_row_id, o.version_row_id, n.cell, n.feature_id, n.category, coalesce(x.existence_after, n.existence_probability),
        n.sigma_m, n.object_height_m, n.last_seen_at, n.observation_count, n.geom
    from conetl.map m
    join conetl.changeset c using (map_id)
    join conetl.effect e using (changeset_id)
    cross join lateral (
        select d.* from conetl.delta d where $3 is null and d.changeset_id = c.changeset_id
        union all
        select d.*
        from (
            select distinct f.cell, f.feature_id from conetl.feature_version f where $3 is not null and conetl.is_in_box(f.geom, f.line, $3)
        ) near
        join conetl.delta d using (cell, feature_id)
        where d.changeset_id = c.changeset_id
    ) x
    join lateral conetl.state_after(x.cell, x.feature_id, x.new_version, x.changeset_id, e.at) n on true
    left join lateral conetl.state_after(
        case when x.kind = 'moved' then x.cell end, x.feature_id, x.old_version, x.changeset_id, e.at
    ) o on true
    where m.map_name = $1 and c.changeset_no = $2 and x.system_period @> e.at
$$;
comment on function conetl.changeset_changes is
    'What a changeset did to each feature that it judged, as committed (or as released, if it was committed on hold). kind missed: '
    'visible but not observed, and still standing. track_index: null where not seen. old_row_id: before a move. version_row_id: the '
    'state after it, of a removed feature the last one, whose columns follow; conetl.feature_state has the others. box: only features '
    'that ever were in it.';
