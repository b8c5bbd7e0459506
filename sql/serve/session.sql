-- Purpose: make a session one that only reads, as conetl_reader where the user is a member of it, and whose queries end.
-- Parameters: timeout (interval text). Columns: role (null where the session keeps its user).
select
    set_config('default_transaction_read_only', 'on', false) as read_only,
    set_config('statement_timeout', %(timeout)s, false) as timeout,
    (
        select set_config('role', r.rolname, false) from pg_roles r
        where r.rolname = 'conetl_reader' and pg_has_role(current_user, r.oid, 'MEMBER')
    ) as role;
