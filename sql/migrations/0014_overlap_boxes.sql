-- Purpose: the constraint that no two believed versions of a feature hold at once, at a third of its cost or less.
--
-- It was kept on (cell, feature, valid period). An index of this kind has no order: on every level all entries of a page are compared, column
-- by column, and a search goes down every page that may hold what it looks for. A cell of 256 m fills several pages, so a search read 16 pages
-- of a map of a million features, which was up to 40 % of what the server did in a merge. Now the first column is a box: across, a number
-- that lies near for features of one cell and is nearly unique; upwards, the valid period in microseconds. A search reads 5 pages.
--
-- It is no weaker. The id stays in the constraint. An id has one cell (feature_of_version), so versions of one feature have boxes at the same
-- place across, and boxes overlap exactly where valid periods do: periods are of whole microseconds and half-open, so their boxes end one
-- microsecond before them. Two features with the same number across, which happens, are told apart by their ids.

-- 15 bits of the cell's row, 16 of its column, 22 of the id's hash: whole numbers that float8 holds. Where a map is larger than these bits, cells
-- far apart share numbers.
create function conetl.place_number(cell bigint, feature_id uuid) returns float8
language sql immutable parallel safe
as $$
    select (((cell >> 32 & 32767) << 38) | ((cell & 65535) << 22) | (uuid_hash(feature_id) & 4194303))::float8
$$;
comment on function conetl.place_number is
    'Nearly one number a feature, near for features of the same cell: where the constraint no_overlap has it.';

-- Exact until 2106; beyond that neighbouring microseconds may become one, never in another order.
create function conetl.microseconds(instant timestamptz) returns float8
language sql immutable parallel safe
as $$
    select greatest(least(round(date_part('epoch', instant at time zone 'UTC') * 1000000), 9.3e18), -9.3e18)
$$;
comment on function conetl.microseconds is 'Since 1970-01-01 UTC, as float8; 9.3e18, later than all instants, for infinity and null.';

create function conetl.version_box(cell bigint, feature_id uuid, valid_period tstzrange) returns box
language sql immutable parallel safe
as $$
    select box(
        point(conetl.place_number(cell, feature_id), conetl.microseconds(lower(valid_period))),
        point(conetl.place_number(cell, feature_id), conetl.microseconds(upper(valid_period)) - 1)
    )
$$;
comment on function conetl.version_box is
    'A version as a line in the plane of place and time: those of one feature overlap where their valid periods do.';

alter table conetl.feature_version drop constraint no_overlap;
alter table conetl.feature_version add constraint no_overlap
    exclude using gist (conetl.version_box(cell, feature_id, valid_period) with &&, feature_id with =)
    where (upper_inf(system_period));
