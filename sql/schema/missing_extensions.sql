-- Purpose: extensions that conetl needs and the server does not offer. Columns: name.
select needed.name
from (values ('postgis'), ('btree_gist')) as needed (name)
where not exists (select from pg_available_extensions a where a.name = needed.name);
