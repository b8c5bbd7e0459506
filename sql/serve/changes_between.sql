-- Purpose: how the map of one instant differs from that of another, each as the database knew it at an instant of its own.
-- Parameters: map_name; from_valid_at, from_known_at, to_valid_at, to_known_at (timestamptz; 'infinity' = latest);
-- moved_from_m: from this horizontal distance on a feature counts as moved; max_rows.
-- Columns: as changes_of_changeset, changed_at is the beginning of the later state's (of removed: null); kind 'confirmed' means
-- the same place with other values, 'unchanged' the same version.
with before as (
    select * from conetl.map_as_of(%(map_name)s, %(from_valid_at)s::timestamptz, %(from_known_at)s::timestamptz)
),

after as (
    select * from conetl.map_as_of(%(map_name)s, %(to_valid_at)s::timestamptz, %(to_known_at)s::timestamptz)
)

select
    coalesce(a.feature_id, b.feature_id) as feature_id,
    case
        when b.feature_id is null then 'added'
        when a.feature_id is null then 'removed'
        when ST_Distance(a.geom, b.geom) >= %(moved_from_m)s then 'moved'
        when a.version <> b.version or not ST_Equals(a.geom, b.geom) then 'confirmed'
        else 'unchanged'
    end as kind,
    lower(a.valid_period) as changed_at,
    ST_Distance(a.geom, b.geom) as shift_m,
    ST_X(b.geom) as old_easting_m,
    ST_Y(b.geom) as old_northing_m,
    ST_Z(b.geom) as old_height_m,
    ST_X(coalesce(a.geom, b.geom)) as easting_m,
    ST_Y(coalesce(a.geom, b.geom)) as northing_m,
    ST_Z(coalesce(a.geom, b.geom)) as height_m,
    coalesce(a.cov_xx, b.cov_xx) as cov_xx,
    coalesce(a.cov_xy, b.cov_xy) as cov_xy,
    coalesce(a.cov_yy, b.cov_yy) as cov_yy,
    coalesce(a.cone_height_m, b.cone_height_m) as cone_height_m,
    coalesce(a.existence_probability, b.existence_probability) as existence_probability,
    coalesce(a.observation_count, b.observation_count) as observation_count,
    coalesce(a.version, b.version) as version
from before b
full outer join after a using (feature_id)
order by 1
limit %(max_rows)s;
