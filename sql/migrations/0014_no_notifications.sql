-- Open pages read the heads of all maps themselves: nobody listens for changes.

drop trigger notify_change on conetl.changeset;
drop trigger notify_change on conetl.decision;
drop trigger notify_change on conetl.base_source;
drop function conetl.notify_change();
