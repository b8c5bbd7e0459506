"""The database reference is made from the comments in sql/: they are those that the database has."""

from __future__ import annotations

from conetl.db.connection import execute
from scripts.mkdocs_hook import plain, schema_as_markdown, schema_comments

_IN_DATABASE = """
select case when c.relkind = 'v' then 'view' else 'table' end as kind, c.relname::text as name,
    obj_description(c.oid, 'pg_class') as text
from pg_class c where c.relnamespace = 'conetl'::regnamespace and c.relkind in ('r', 'v')
union all
select 'function', p.proname::text, obj_description(p.oid, 'pg_proc') from pg_proc p where p.pronamespace = 'conetl'::regnamespace
"""


def test_every_table_view_and_function_is_in_the_reference(conn):
    found = {(row["kind"], row["name"]): row["text"] for row in execute(conn, _IN_DATABASE)}
    assert found == {key: text for key, text in schema_comments().items() if key[0] in ("table", "view", "function")}
    page = schema_as_markdown()
    assert all(f"- `{name}`: {plain(text)}\n" in page for (_, name), text in found.items())
