-- Purpose: how many features of a map there are on all pages. Parameters: $1 map name; $2, $3, $4 from_at, to_at, known_at (text of instants);
-- then those of the box.
-- Put in by the caller: {{source}} (as for ogc_features_page.sql; conetl_ogc.features looks every feature up once more), {{box}} (named
-- arguments of it, each after a comma), {{where}}.
-- Columns: matched.
select count(*) as matched
from {{source}}($1, $2::text::timestamptz, $3::text::timestamptz, $4::text::timestamptz{{box}})
{{where}};
