-- Maps are managed: numbers of changesets count per map from 1, and a map may be renamed, deleted and restored.

alter table conetl.changeset alter column changeset_no drop identity;
alter table conetl.changeset drop constraint changeset_changeset_no_key;
update conetl.changeset c
set changeset_no = n.no
from (
    select changeset_id, row_number() over (partition by map_id order by changeset_no) as no
    from conetl.changeset
) n
where n.changeset_id = c.changeset_id and n.no <> c.changeset_no;
alter table conetl.changeset add unique (map_id, changeset_no);
comment on column conetl.changeset.changeset_no is 'Counts the changesets of its map from 1; rises with system time.';

-- Ids of features contain the name that their map had when it was created, so that a drive that is compared again finds them.
alter table conetl.map add column id_name text unique check (id_name <> '');
comment on column conetl.map.id_name is
    'Name in the ids of its features where that is not map_name: of a map that was renamed, or has the name that another one had.';

alter table conetl.map add column vertical_srid integer check (vertical_srid > 0);
comment on column conetl.map.vertical_srid is
    'Height system in which exports state heights (EPSG); null: ellipsoidal. Stored heights are always ellipsoidal.';
