-- Purpose: every covariance matrix is finite and positive definite (variances positive, correlations possible).
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
where not (xx > 0 and yy > 0 and zz > 0 and xx < 'infinity' and yy < 'infinity' and zz < 'infinity')
or case
    when xx > 0 and yy > 0 and zz > 0 and xx < 'infinity' and yy < 'infinity' and zz < 'infinity' then
        -- Scaled to correlations, so that small variances do not drown in rounding.
        abs(xy / sqrt(xx) / sqrt(yy)) >= 1
        or 1 + 2 * (xy / sqrt(xx) / sqrt(yy)) * (xz / sqrt(xx) / sqrt(zz)) * (yz / sqrt(yy) / sqrt(zz))
            - (xy / sqrt(xx) / sqrt(yy)) ^ 2 - (xz / sqrt(xx) / sqrt(zz)) ^ 2 - (yz / sqrt(yy) / sqrt(zz)) ^ 2 <= 0
        or xy = 'nan' or xz = 'nan' or yz = 'nan'
    else false
end;
