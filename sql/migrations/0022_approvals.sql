-- A person may approve what a drive did to a feature. It changes nothing on the map, and ends with the next change of the feature.

alter table conetl.decision add column approves uuid references conetl.changeset;
comment on column conetl.decision.approves is 'Of approve: the changeset whose change of the feature is right.';
alter table conetl.decision drop constraint decision_kind_check;
alter table conetl.decision
    add constraint decision_kind_check check (kind in ('suppress', 'pin', 'classify', 'approve', 'revert', 'accept', 'withdraw')),
    add constraint decision_has_approval check ((kind = 'approve') = (approves is not null));
comment on table conetl.decision is 'What people decided: suppress, pin, classify, approve, revert, accept, withdraw. Append-only.';
