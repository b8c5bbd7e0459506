-- A person may say of which class an object is: what drives detect as found_as within radius_m of geom is a category.

alter table conetl.decision
    add column category text,
    add column found_as text;
alter table conetl.decision drop constraint decision_kind_check;
alter table conetl.decision drop constraint decision_check;
alter table conetl.decision
    add constraint decision_kind_check check (kind in ('suppress', 'pin', 'classify', 'revert', 'accept', 'withdraw')),
    add constraint decision_check check ((kind in ('suppress', 'pin', 'classify')) = (geom is not null and radius_m is not null)),
    add constraint decision_has_classes check (num_nonnulls(category, found_as) = case kind when 'classify' then 2 else 0 end);

create or replace view conetl.active_decision as
select d.*
from conetl.decision d
where d.kind <> 'withdraw' and not exists (select from conetl.decision w where w.withdraws = d.decision_id);
