-- Purpose: the licence of a map's data. Parameters: map_name; licence (null: none).
update conetl.map set licence = %(licence)s where map_name = %(map_name)s;
