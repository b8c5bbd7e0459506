-- Purpose: open pages learn of a change at once, and a decision keeps the name of the person who made it.
--
-- Whatever is committed to a map (a changeset, a decision, a base layer that was imported or dropped) is told on the channel
-- `conetl_news`, without content: who listens asks what there is now. NOTIFY is sent at commit, once a transaction.

create function conetl.tell_news() returns trigger
language plpgsql
as $$
begin
    perform pg_notify('conetl_news', '');
    return null;
end
$$;
comment on function conetl.tell_news is 'Trigger: something that the web view shows was changed by this transaction.';

create trigger tell_news after insert on conetl.changeset for each statement execute function conetl.tell_news();
create trigger tell_news after insert on conetl.decision for each statement execute function conetl.tell_news();
create trigger tell_news after insert or update or delete on conetl.base_source
for each statement execute function conetl.tell_news();

alter table conetl.decision add column decided_by text check (decided_by <> '');
comment on column conetl.decision.decided_by is 'Name of the person, as given; null: decided before names were kept.';

create or replace view conetl.active_decision as
select d.*
from conetl.decision d
where d.kind <> 'withdraw' and not exists (select from conetl.decision w where w.withdraws = d.decision_id);
