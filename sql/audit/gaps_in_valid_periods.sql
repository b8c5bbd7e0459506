-- Purpose: what is believed now about a feature has no gap in time from its first version on.
-- Columns: feature_id, version, valid_period, problem.
select feature_id, version, valid_period::text as valid_period, 'does not begin where the one before it ends' as problem
from (
    select
        feature_id, version, valid_period,
        lag(upper(valid_period)) over w as previous_end,
        row_number() over w as place
    from conetl.feature_version
    where upper_inf(system_period)
    window w as (partition by feature_id order by lower(valid_period))
) believed
where place > 1 and previous_end is distinct from lower(valid_period);
