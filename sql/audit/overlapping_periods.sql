-- Purpose: no two versions of a feature are believed for the same instant at the same time.
-- Columns: feature_id, version, other_version, valid_period, other_valid_period, problem.
select
    a.feature_id, a.version, b.version as other_version,
    a.valid_period::text as valid_period, b.valid_period::text as other_valid_period,
    'two versions at once' as problem
from conetl.feature_version a
join conetl.feature_version b
    on b.feature_id = a.feature_id and b.version_row_id > a.version_row_id
    and b.valid_period && a.valid_period and b.system_period && a.system_period;
