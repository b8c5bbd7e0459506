-- A drive on hold is stored and does not count, as one that was reverted; a person accepts it by withdrawing the hold.
alter table conetl.decision drop constraint decision_kind_check;
alter table conetl.decision drop constraint decision_check2;
alter table conetl.decision add constraint decision_kind_check
    check (kind in ('suppress', 'pin', 'revert', 'hold', 'withdraw'));
alter table conetl.decision add constraint decision_check2
    check ((kind in ('revert', 'hold')) = (changeset_id is not null));
