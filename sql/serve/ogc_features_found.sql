-- Purpose: which versions are on a page of features out of many, and how many there are on all pages, by one look at the table. What the
-- page says of them is asked afterwards (ogc_features_page.sql): here a row is narrow, so that a million of them are put aside for counting.
-- Parameters: $1 limit, $2 offset; $3 map name; $4, $5, $6 from_at, to_at, known_at (text of instants); then those of the box.
-- Put in by the caller: {{box}} (named arguments of conetl_ogc.standing, each after a comma), {{by_place}} (true: by the index of places, false:
-- through the whole table), {{where}}, {{order}}.
-- Columns: version_row_id (in order), matched (the same in all rows).
select s.version_row_id, count(*) over () as matched
from conetl_ogc.standing($3, $4::text::timestamptz, $5::text::timestamptz, $6::text::timestamptz{{box}}, by_place => {{by_place}}) s
{{where}}
order by {{order}}
limit $1 offset $2;
