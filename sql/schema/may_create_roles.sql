-- Purpose: may the connected user create roles? Columns: may_create_roles.
select rolsuper or rolcreaterole as may_create_roles from pg_roles where rolname = current_user;
