-- Purpose: exactly one version of every feature is believed and open now.
-- Columns: feature_id, open_count, problem.
select f.feature_id, count(v.*) as open_count, 'should have one open version' as problem
from conetl.feature f
left join conetl.feature_version v
    on v.feature_id = f.feature_id and upper_inf(v.system_period) and upper_inf(v.valid_period)
group by f.feature_id
having count(v.*) <> 1;
