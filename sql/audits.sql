-- Audits: each statement returns the offending rows, with a column `problem`; none if the audit passes.

-- name: changeset_counts
-- Every changeset has as many deltas and records as it states (deltas as committed, not as replayed since; a pruned
-- drive has no detections, stereo matches and positions).
-- Columns: changeset_id, what, stated, found, problem.
with as_committed as (
    select p.changeset_id, jsonb_object_agg(p.part, p.counts) as change_counts
    from (
        select k.changeset_id, k.part, jsonb_object_agg(k.kind, k.n) as counts
        from (
            select x.changeset_id, case when x.of_line then 'lines' else 'points' end as part, x.kind, count(*) as n
            from conetl.delta x
            join conetl.changeset c on c.changeset_id = x.changeset_id and c.committed_at = lower(x.system_period)
            group by x.changeset_id, part, x.kind
        ) k
        group by k.changeset_id, k.part
    ) p
    group by p.changeset_id
)
select c.changeset_id, 'changes' as what, c.change_counts as stated, k.found, 'the numbers differ' as problem
from conetl.changeset c
left join as_committed x using (changeset_id)
cross join lateral (select '{"points": {}, "lines": {}}' || coalesce(x.change_counts, '{}')) k (found)
where c.change_counts <> k.found
union all
select c.changeset_id, counted.what, to_jsonb(counted.stated), to_jsonb(counted.found), 'the numbers differ'
from conetl.changeset c
join conetl.drive d using (drive_uuid)
cross join lateral (
    values
        ('frame pairs', c.frame_pair_count, (select count(*) from conetl.frame_pair r where r.drive_uuid = c.drive_uuid)),
        ('detections', case when d.pruned_at is null then c.detection_count else 0 end,
            (select count(*) from conetl.detection r where r.drive_uuid = c.drive_uuid)),
        ('stereo matches', case when d.pruned_at is null then c.match_count else 0 end,
            (select count(*) from conetl.stereo_match r where r.drive_uuid = c.drive_uuid)),
        ('positions', case when d.pruned_at is null then c.position_count else 0 end,
            (select count(*) from conetl.position r where r.drive_uuid = c.drive_uuid)),
        ('tracks', c.track_count, (select count(*) from conetl.track r where r.drive_uuid = c.drive_uuid)),
        ('lane markings', c.marking_count,
            (select count(*) from conetl.marking_track r where r.drive_uuid = c.drive_uuid)),
        ('rejections', c.rejection_count, (select count(*) from conetl.quarantine r where r.changeset_id = c.changeset_id))
) counted (what, stated, found)
where counted.stated <> counted.found;

-- name: decisions
-- Every decision refers to its own map: to a feature and a changeset of that map and to an earlier decision about it,
-- and no changeset is reverted twice at once.
-- Columns: decision_id, kind, problem.
select d.decision_id, d.kind, p.problem
from conetl.decision d
left join conetl.feature f on f.feature_id = d.feature_id
left join conetl.changeset c on c.changeset_id = d.changeset_id
left join conetl.decision w on w.decision_id = d.withdraws
cross join lateral (
    select case
        when d.feature_id is not null and f.feature_id is null then 'its feature does not exist'
        when f.map_id <> d.map_id then 'its feature is of another map'
        when d.changeset_id is not null and c.changeset_id is null then 'its changeset does not exist'
        when c.map_id <> d.map_id then 'its changeset is of another map'
        when d.withdraws is not null and w.decision_id is null then 'it withdraws a decision that does not exist'
        when w.map_id <> d.map_id then 'it withdraws a decision of another map'
        when w.kind = 'withdraw' then 'it withdraws a withdrawal'
        when w.decided_at >= d.decided_at then 'it withdraws a decision that was not made before it'
        when c.committed_at >= d.decided_at then 'it is about a changeset that was not committed before it'
        when d.changeset_id is not null and exists (select from conetl.active_decision a where a.decision_id = d.decision_id) and exists (
            select from conetl.active_decision a
            where a.kind = d.kind and a.changeset_id = d.changeset_id and a.decision_id <> d.decision_id
        ) then 'another decision says the same about its changeset'
    end as problem
) p
where p.problem is not null;

-- name: evidence
-- The counts of drives and the existence probability of every current row are those of the current deltas up to the drive that made
-- the row, and every miss has a row, unless a later drive precedes it on the road.
-- Columns: feature_id, version, problem, expected, found.
with judged as (
    select
        x.cell, x.feature_id, x.changeset_id, x.kind, x.new_version, x.changed_at_ns,
        count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and x.drive_kind = 'drive') over w as seen,
        count(*) filter (where x.kind in ('missed', 'removed')) over w as missed,
        coalesce(
            x.existence_after,
            case when x.kind = 'merged' then
                (array_agg(x.existence_after) filter (where x.existence_after is not null) over w)[count(x.existence_after) over w]
            end
        ) as existence,
        case when x.kind = 'missed' then min(x.changed_at_ns) filter (where x.kind = 'missed') over (
            partition by x.feature_id, x.new_version order by x.drive_order
        ) end as first_missed_ns
    from conetl.feature_delta x
    where upper_inf(x.system_period)
    window w as (partition by x.feature_id order by x.drive_order)
)
select
    v.feature_id, v.version, 'its evidence is not that of its drives' as problem,
    format('%s seen, %s missed, existence %s, missed since %s', j.seen, j.missed, j.existence, j.first_missed_ns) as expected,
    format('%s seen, %s missed, existence %s, missed since %s', v.seen_count, v.missed_count, v.existence_probability, v.first_missed_ns)
        as found
from conetl.feature_version v
join judged j on j.cell = v.cell and j.feature_id = v.feature_id and j.changeset_id = v.changeset_id
where upper_inf(v.system_period) and (
    (v.seen_count, v.missed_count, v.first_missed_ns) is distinct from (j.seen, j.missed, j.first_missed_ns)
    or v.existence_probability <> coalesce(j.existence, v.existence_probability)
)
union all
select j.feature_id, j.new_version, 'a drive missed it, and no row says so', 'a row from ' || j.changed_at_ns, 'none'
from judged j
where j.kind = 'missed' and not exists (
    select from conetl.feature_version v
    where v.cell = j.cell and v.feature_id = j.feature_id and upper_inf(v.system_period)
    and (v.changeset_id = j.changeset_id or (v.missed_count >= j.missed and v.valid_from_ns <= j.changed_at_ns + 1000))
);

-- name: gaps_in_valid_periods
-- The current versions of a feature have no gap in time from the first one on.
-- Columns: feature_id, version, valid_period, problem.
select feature_id, version, valid_period::text as valid_period, 'does not begin where the one before it ends' as problem
from (
    select
        feature_id, version, valid_period,
        lag(upper(valid_period)) over w as previous_end,
        row_number() over w as n
    from conetl.feature_version
    where upper_inf(system_period)
    window w as (partition by feature_id order by lower(valid_period))
) current
where n > 1 and previous_end is distinct from lower(valid_period);

-- name: invalid_covariance
-- Every covariance matrix is finite and positive definite (variances positive, correlations possible).
-- Columns: table_name, record, problem.
with matrix as (
    select 'feature_version' as table_name, feature_id || ' version ' || version as record,
        cov_xx as xx, cov_xy as xy, cov_xz as xz, cov_yy as yy, cov_yz as yz, cov_zz as zz
    from conetl.feature_version
    union all
    select 'track', drive_uuid || ' track ' || track_index, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz
    from conetl.track
    union all
    select 'position', drive_uuid || ' frame ' || frame_index || ' match ' || match_index,
        cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz
    from conetl.position
)
select table_name, record, 'is not positive definite' as problem
from matrix
where case
    when xx > 0 and yy > 0 and zz > 0 and xx < 'infinity' and yy < 'infinity' and zz < 'infinity' then
        -- Scaled to correlations, so that small variances are not lost in rounding.
        abs(xy / sqrt(xx) / sqrt(yy)) >= 1
        or 1 + 2 * (xy / sqrt(xx) / sqrt(yy)) * (xz / sqrt(xx) / sqrt(zz)) * (yz / sqrt(yy) / sqrt(zz))
            - (xy / sqrt(xx) / sqrt(yy)) ^ 2 - (xz / sqrt(xx) / sqrt(zz)) ^ 2 - (yz / sqrt(yy) / sqrt(zz)) ^ 2 <= 0
        or xy = 'nan' or xz = 'nan' or yz = 'nan'
    else true
end;

-- name: invalid_geometry
-- Every point is finite, three-dimensional and in the CRS of its map.
-- Columns: table_name, record, geometry, problem.
with point as (
    select
        'feature_version' as table_name, v.feature_id || ' version ' || v.version as record, m.srid, g.geom
    from conetl.feature_version v
    join conetl.map m using (map_id)
    cross join lateral (values (v.geom), (v.centre_geom)) g (geom)
    union all
    select 'position', p.drive_uuid || ' frame ' || p.frame_index || ' match ' || p.match_index, d.srid, g.geom
    from conetl.position p
    join conetl.drive d using (drive_uuid)
    cross join lateral (values (p.geom), (p.centre_geom)) g (geom)
    union all
    select 'track', t.drive_uuid || ' track ' || t.track_index, d.srid, g.geom
    from conetl.track t
    join conetl.drive d using (drive_uuid)
    cross join lateral (values (t.geom), (t.centre_geom)) g (geom)
    union all
    select 'frame_pair', f.drive_uuid || ' frame ' || f.frame_index, d.srid, f.geom
    from conetl.frame_pair f
    join conetl.drive d using (drive_uuid)
)
select table_name, record, ST_AsEWKT(geom) as geometry,
    case when ST_SRID(geom) <> srid then 'should have SRID ' || srid else 'is not a finite point' end as problem
from point
where ST_SRID(geom) <> srid
or ST_IsEmpty(geom)
or not (ST_X(geom) between -1e9 and 1e9 and ST_Y(geom) between -1e9 and 1e9 and ST_Z(geom) between -1e6 and 1e6);

-- name: lines
-- Every line has its own covariance per vertex, and the position of its feature is its middle vertex; properties of lines
-- belong to features that are lines.
-- Columns: table_name, record, problem.
select 'feature_version' as table_name, v.feature_id || ' version ' || v.version as record, p.problem
from conetl.feature_version v
cross join lateral (select ST_PointN(v.line, ST_NPoints(v.line) / 2 + 1) as geom, ST_NPoints(v.line) / 2 + 1 as number) middle
cross join lateral (
    select case
        when array_ndims(v.line_cov) <> 2 or array_length(v.line_cov, 1) <> ST_NPoints(v.line) or array_length(v.line_cov, 2) <> 6
            then 'has not one covariance per vertex'
        when not ST_3DDWithin(middle.geom, v.geom, 1e-6) or not ST_3DDWithin(v.centre_geom, v.geom, 1e-6)
            then 'is not at its middle vertex'
        when v.line_cov[middle.number][1] <> v.cov_xx or v.line_cov[middle.number][4] <> v.cov_yy or v.line_cov[middle.number][6] <> v.cov_zz
            then 'has another covariance than its middle vertex'
        when (v.pattern = 'dashed') <> (v.dash_m is not null) then 'has lengths of dashes that do not fit its pattern'
    end as problem
) p
where v.line is not null and p.problem is not null
union all
select 'marking_track', t.drive_uuid || ' marking ' || t.marking_index, 'has not one covariance per vertex'
from conetl.marking_track t
where array_length(t.line_cov, 1) <> ST_NPoints(t.line) or array_length(t.relative_cov, 1) <> ST_NPoints(t.line)
union all
select 'delta', x.changeset_id || ' feature ' || x.feature_id, 'is not of a feature of its kind'
from conetl.delta x
join conetl.feature_version v on v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version
    and v.system_period && x.system_period
where x.of_line <> (v.line is not null);

-- name: open_versions
-- Every feature with current versions has exactly one open version, and every feature has a version.
-- Columns: feature_id, open_count, problem.
select f.feature_id, count(v.*) filter (where upper_inf(v.system_period) and upper_inf(v.valid_period)) as open_count,
    case when count(v.*) = 0 then 'has no version' else 'should have one open version' end as problem
from conetl.feature f
left join conetl.feature_version v using (feature_id)
group by f.feature_id
having count(v.*) = 0
or count(v.*) filter (where upper_inf(v.system_period)) > 0
    and count(v.*) filter (where upper_inf(v.system_period) and upper_inf(v.valid_period)) <> 1;

-- name: orphan_deltas
-- Every delta belongs to a changeset and a feature of the same map, and the versions and the track that it names exist.
-- Columns: changeset_id, feature_id, kind, problem.
select x.changeset_id, x.feature_id, x.kind, p.problem
from conetl.delta x
left join conetl.changeset c on c.changeset_id = x.changeset_id
left join conetl.feature f on f.feature_id = x.feature_id
cross join lateral (
    select case
        when c.changeset_id is null then 'has no changeset'
        when f.feature_id is null then 'has no feature'
        when f.cell <> x.cell then 'its cell is not the one of its feature'
        when f.map_id <> c.map_id then 'its feature and its changeset are of different maps'
        when not exists (
            select from conetl.feature_version v
            where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version and (v.system_period && x.system_period)
        ) then 'its new version does not exist'
        when x.old_version is not null and not exists (
            select from conetl.feature_version v
            where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.old_version and (v.system_period && x.system_period)
        ) then 'its old version does not exist'
        when x.track_index is not null and not exists (
            select from conetl.track t where t.drive_uuid = c.drive_uuid and t.track_index = x.track_index
        ) then 'its track does not exist'
    end as problem
) p
where p.problem is not null;

-- name: orphan_records
-- Every raw record belongs to its drive, frame pair, stereo match, position and track (the positions of a pruned drive
-- are deleted), and every drive to a changeset.
-- Columns: table_name, drive_uuid, row_count, problem.
select 'drive' as table_name, d.drive_uuid, count(*) as row_count, 'has no changeset' as problem
from conetl.drive d
where not exists (select from conetl.changeset c where c.drive_uuid = d.drive_uuid)
group by d.drive_uuid
union all
select 'frame_pair', p.drive_uuid, count(*), 'has no drive'
from conetl.frame_pair p
where not exists (select from conetl.drive d where d.drive_uuid = p.drive_uuid)
group by p.drive_uuid
union all
select 'detection', x.drive_uuid, count(*), 'has no frame pair'
from conetl.detection x
where not exists (
    select from conetl.frame_pair p where p.drive_uuid = x.drive_uuid and p.frame_index = x.frame_index
)
group by x.drive_uuid
union all
select 'stereo_match', s.drive_uuid, count(*), 'has no detection, or an unknown one'
from conetl.stereo_match s
where num_nonnulls(s.left_detection_index, s.right_detection_index) = 0 or s.left_detection_index is not null and not exists (
    select from conetl.detection l
    where l.drive_uuid = s.drive_uuid and l.frame_index = s.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
) or s.right_detection_index is not null and not exists (
    select from conetl.detection r
    where r.drive_uuid = s.drive_uuid and r.frame_index = s.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index
)
group by s.drive_uuid
union all
select 'position', x.drive_uuid, count(*), 'has no frame pair'
from conetl.position x
where not exists (
    select from conetl.frame_pair p where p.drive_uuid = x.drive_uuid and p.frame_index = x.frame_index
)
group by x.drive_uuid
union all
select 'track_member', t.drive_uuid, count(*), 'has no position'
from conetl.track_member t
where not exists (
    select from conetl.position p
    where p.drive_uuid = t.drive_uuid and p.frame_index = t.frame_index and p.match_index = t.match_index
) and not exists (
    select from conetl.drive d where d.drive_uuid = t.drive_uuid and d.pruned_at is not null
)
group by t.drive_uuid;

-- name: orphan_versions
-- Every feature version belongs to a feature and to a changeset of the same map.
-- Columns: feature_id, version, changeset_id, problem.
select
    v.feature_id, v.version, v.changeset_id,
    case
        when f.feature_id is null then 'has no feature'
        when c.changeset_id is null then 'has no changeset'
        when f.cell <> v.cell then 'its cell is not the one of its feature'
        else 'feature, changeset and version are of different maps'
    end as problem
from conetl.feature_version v
left join conetl.feature f on f.feature_id = v.feature_id
left join conetl.changeset c on c.changeset_id = v.changeset_id
where f.feature_id is null or c.changeset_id is null or f.map_id <> c.map_id or v.map_id <> f.map_id or v.cell <> f.cell;

-- name: overlapping_periods
-- No two versions of a feature are valid for the same instant at the same system time.
-- Columns: feature_id, version, other_version, valid_period, other_valid_period, problem.
select
    a.feature_id, a.version, b.version as other_version,
    a.valid_period::text as valid_period, b.valid_period::text as other_valid_period,
    'two versions at once' as problem
from conetl.feature_version a
join conetl.feature_version b
    on b.feature_id = a.feature_id and b.version_row_id > a.version_row_id
    and b.valid_period && a.valid_period and b.system_period && a.system_period;

-- name: replay
-- Replaying all current deltas in the order in which their drives were recorded gives the map as it is, every delta
-- starts from the result of the one before, and only active drives have current deltas.
-- Columns: feature_id, problem, expected, found.
with chain as (
    select
        x.feature_id, x.kind, x.old_version, x.new_version,
        lag(x.new_version) over w as left_version,
        lag(x.kind) over w as left_kind,
        lead(x.kind) over w is null as is_last
    from conetl.feature_delta x
    where upper_inf(x.system_period)
    window w as (partition by x.feature_id order by x.drive_order)
),
current as (
    select feature_id, version, present or suppressed as present
    from conetl.feature_version
    where upper_inf(system_period) and upper_inf(valid_period)
)
select
    feature_id, 'the delta does not start from what the one before it left' as problem,
    coalesce(left_version::text, 'nothing') as expected, coalesce(old_version::text, 'nothing') as found
from chain
where case
    when kind in ('added', 'split') then old_version is not null or not coalesce(left_kind in ('removed', 'merged'), true)
    else left_version is distinct from old_version or left_kind in ('removed', 'merged')
end
union all
select
    coalesce(l.feature_id, v.feature_id), 'the map is not what its deltas make',
    coalesce('version ' || l.new_version || case when l.kind in ('removed', 'merged') then ', gone' else ', standing' end, 'nothing'),
    coalesce('version ' || v.version || case when v.present then ', standing' else ', gone' end, 'nothing')
from (select * from chain where is_last) l
full join current v using (feature_id)
where l.new_version is distinct from v.version or (l.kind not in ('removed', 'merged')) is distinct from v.present
union all
select x.feature_id, 'is still changed by a drive that does not count', 'nothing', x.kind
from conetl.delta x
where upper_inf(x.system_period) and exists (select from conetl.changeset c where c.changeset_id = x.changeset_id)
and not exists (select from conetl.active_drive a where a.changeset_id = x.changeset_id);

-- name: shared_jacobian
-- Shared-error Jacobians fit their calibrations, have three axes each, and do not exceed the covariance that they are
-- part of.
-- Columns: table_name, record, problem.
with jacobian as (
    select 'feature_version' as table_name, feature_id || ' version ' || version as record, calibrations, shared_jacobian_m,
        cov_xx, cov_yy, cov_zz
    from conetl.feature_version
    where calibrations is not null or shared_jacobian_m is not null
    union all
    select 'track', drive_uuid || ' track ' || track_index, calibrations, shared_jacobian_m, cov_xx, cov_yy, cov_zz
    from conetl.track
    where calibrations is not null or shared_jacobian_m is not null
),
shaped as (
    select
        l.*,
        coalesce(
            array_ndims(calibrations) = 1 and array_position(calibrations, null) is null
            and array_ndims(shared_jacobian_m) = 3 and array_length(shared_jacobian_m, 1) = array_length(calibrations, 1)
            and array_length(shared_jacobian_m, 2) = 3,
            false
        ) as fits
    from jacobian l
)
select table_name, record, 'has a shared_jacobian_m that does not fit its calibrations' as problem
from shaped
where not fits
union all
select table_name, record, 'has a shared_jacobian_m that exceeds its covariance'
from shaped
cross join lateral (
    -- Numbered as arrays are stored: by calibration, axis and error.
    select
        sum(u.metres::float8 ^ 2) filter (where mod((u.number - 1) / array_length(shared_jacobian_m, 3), 3) = 0) as xx,
        sum(u.metres::float8 ^ 2) filter (where mod((u.number - 1) / array_length(shared_jacobian_m, 3), 3) = 1) as yy,
        sum(u.metres::float8 ^ 2) filter (where mod((u.number - 1) / array_length(shared_jacobian_m, 3), 3) = 2) as zz
    from unnest(shared_jacobian_m) with ordinality u (metres, number)
) stated
-- Jacobians are rounded to 1e-7 of their values.
where fits and not coalesce(xx <= 1.0001 * cov_xx and yy <= 1.0001 * cov_yy and zz <= 1.0001 * cov_zz, false);

-- name: suppressed_locations
-- Exactly the current versions at locations that a person suppressed are suppressed.
-- Columns: feature_id, version, problem.
-- A micrometre around the edge of a location is ignored: two programs compare distances with radii there.
with location as (
    select map_id, geom, radius_m, of_line from conetl.active_decision where kind = 'suppress'
)
select v.feature_id, v.version, 'is suppressed, but at no suppressed location' as problem
from conetl.feature_version v
where v.suppressed and upper_inf(v.system_period)
and not exists (select from location p where p.map_id = v.map_id and p.of_line = (v.line is not null) and ST_DWithin(v.geom, p.geom, p.radius_m + 1e-6))
union
select v.feature_id, v.version, 'stands at a suppressed location, but is not suppressed'
from location p
join conetl.feature_version v on v.map_id = p.map_id and p.of_line = (v.line is not null)
    and ST_DWithin(v.geom, p.geom, greatest(p.radius_m - 1e-6, 0))
where v.present and upper_inf(v.system_period);

-- name: feature_cells
-- The stored overview is the number of features that stand now, in every cell.
-- Columns: map_name, zoom, x, y, category, problem, expected, found.
select
    m.map_name, zoom, x, y, category, 'the number of features in this cell, or their mean position, is wrong' as problem,
    e.n as expected, f.feature_count as found
from (
    select
        s.map_id, z as zoom, floor(s.easting_m / 2 ^ (20 - z))::integer as x, floor(s.northing_m / 2 ^ (20 - z))::integer as y, s.category,
        s.line is not null as is_line, count(*) as n,
        array[sum(round(s.easting_m * 100)), sum(round(s.northing_m * 100)), sum(round(s.ellipsoidal_height_m * 100))]::bigint[] as sum_cm
    from conetl.current_feature s
    cross join conetl.cell_zooms() z
    group by 1, 2, 3, 4, 5, 6
) e
full join conetl.feature_cell f using (map_id, zoom, x, y, category, is_line)
join conetl.map m on m.map_id = coalesce(e.map_id, f.map_id)
where (e.n, e.sum_cm) is distinct from (f.feature_count::bigint, f.sum_cm);
