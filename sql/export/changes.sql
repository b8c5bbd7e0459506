-- Purpose: features that differ between the map of one instant on the road and that of a later one, both as believed at one instant.
-- Parameters: map_name; from_valid_at, to_valid_at, known_at (timestamptz; 'infinity' = latest); moved_from_m: a place that differs
-- by more (horizontally) was moved, by less is only known better; spatial_order, time_order (both false: by feature_id).
-- Columns: as export/versions, of the later state (of removed features: of the earlier one, but valid_to: when they were gone, whatever
-- confirmed them in between), change (added, moved, confirmed, removed) and shift_m; old_easting_m, old_northing_m, old_height_m, old_version: of the earlier state (of added features: null);
-- seen_count, missed_count: drives that saw the feature and that looked in vain, until to_valid_at.
with before as (
    select f.feature_id, f as state
    from conetl.map_as_of(%(map_name)s, %(from_valid_at)s::timestamptz, %(known_at)s::timestamptz) f
),

after as (
    select f.feature_id, f as state
    from conetl.map_as_of(%(map_name)s, %(to_valid_at)s::timestamptz, %(known_at)s::timestamptz) f
),

both_states as (
    select b.state as old, a.state as new, coalesce(a.state, b.state) as state
    from before b
    full outer join after a using (feature_id)
    where b.feature_id is null or a.feature_id is null or (a.state).version_row_id <> (b.state).version_row_id
)

select
    (c.state).feature_id,
    (c.state).version,
    (c.state).category,
    coalesce(e.existence_after, (c.state).existence_probability) as existence_probability,
    (c.state).cone_height_m as height_m,
    sqrt((c.state).cov_xx) as sigma_e_m,
    sqrt((c.state).cov_yy) as sigma_n_m,
    sqrt((c.state).cov_zz) as sigma_u_m,
    (c.state).first_seen_ns,
    (c.state).last_seen_ns,
    (c.state).observation_count,
    lower((c.state).valid_period) as valid_from,
    case
        when (c.new).feature_id is null then (
            select max(upper(v.valid_period))
            from conetl.feature_version v
            where v.cell = (c.old).cell and v.feature_id = (c.old).feature_id and v.present
            and lower(v.valid_period) <= %(to_valid_at)s::timestamptz and v.system_period @> %(known_at)s::timestamptz
        )
        else upper((c.state).valid_period)
    end as valid_to,
    (c.state).changeset_id,
    e.seen_count,
    e.missed_count,
    (c.state).cone_height_sigma_m as height_sigma_m,
    (c.state).cov_xy as cov_en_m2,
    (c.state).cov_xz as cov_eu_m2,
    (c.state).cov_yz as cov_nu_m2,
    case
        when (c.old).feature_id is null then 'added'
        when (c.new).feature_id is null then 'removed'
        when ST_Distance((c.old).geom, (c.new).geom) > %(moved_from_m)s then 'moved'
        else 'confirmed'
    end as change,
    ST_Distance((c.old).geom, (c.new).geom) as shift_m,
    (c.old).version as old_version,
    ST_X((c.old).geom) as old_easting_m,
    ST_Y((c.old).geom) as old_northing_m,
    ST_Z((c.old).geom) as old_height_m,
    ST_X((c.state).geom) as easting_m,
    ST_Y((c.state).geom) as northing_m,
    ST_Z((c.state).geom) as ellipsoidal_height_m
from both_states c
cross join lateral conetl.feature_evidence(
    (c.state).feature_id, (c.state).version, %(to_valid_at)s::timestamptz, %(known_at)s::timestamptz
) e
order by
    case when %(spatial_order)s then (c.state).geom end,
    case when %(time_order)s then lower((c.state).valid_period) end,
    (c.state).feature_id;
