-- Purpose: shared_jacobian come with the calibrations that they are of, three axes each, and state no more than the covariance that they are
-- part of.
-- Columns: table_name, record, problem.
with lever as (
    select 'feature_version' as table_name, feature_id || ' version ' || version as record, calibrations, shared_jacobian_m, cov_xx, cov_yy, cov_zz
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
            and array_ndims(shared_jacobian_m) = 3 and array_length(shared_jacobian_m, 1) = array_length(calibrations, 1) and array_length(shared_jacobian_m, 2) = 3,
            false
        ) as fits
    from lever l
)
select table_name, record, 'has shared_jacobian that do not fit their calibrations' as problem
from shaped
where not fits
union all
select table_name, record, 'has shared_jacobian that state more than its covariance'
from shaped
cross join lateral (
    -- Numbered as arrays are stored: by calibration, axis and error.
    select
        sum(u.metres::float8 ^ 2) filter (where mod((u.number - 1) / array_length(shared_jacobian_m, 3), 3) = 0) as xx,
        sum(u.metres::float8 ^ 2) filter (where mod((u.number - 1) / array_length(shared_jacobian_m, 3), 3) = 1) as yy,
        sum(u.metres::float8 ^ 2) filter (where mod((u.number - 1) / array_length(shared_jacobian_m, 3), 3) = 2) as zz
    from unnest(shared_jacobian_m) with ordinality u (metres, number)
) stated
-- SharedErrorJacobian are rounded to 1e-7 of themselves.
where fits and not coalesce(xx <= 1.0001 * cov_xx and yy <= 1.0001 * cov_yy and zz <= 1.0001 * cov_zz, false);
