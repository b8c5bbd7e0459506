-- Purpose: what lies under the cones: point clouds as tiles, and lane boundaries, each with the file that it came from.
--
-- Base layers are no part of the map's history: they are loaded, renewed and dropped as a whole. Coordinates are those of the map's
-- CRS, in metres. A tile's points count from its origin in steps of its scale (readers/base_layers/point_tiles.py tells the bytes).

create table conetl.base_source (
    source_id      uuid primary key,
    map_id         integer not null,
    srid           integer not null,
    layer_name     text not null check (layer_name ~ '^[A-Za-z0-9][A-Za-z0-9 ._-]{0,59}$'),
    kind           text not null check (kind in ('points', 'lines')),
    source_path    text not null,
    content_sha256 text not null check (content_sha256 ~ '^[0-9a-f]{64}$'),  -- of the file
    params         jsonb not null,
    source_crs     text not null,
    read_count     bigint not null check (read_count >= 0),     -- points or lines in the file
    kept_count     bigint not null check (kept_count > 0),      -- after thinning
    refused_count  bigint not null check (refused_count >= 0),  -- no numbers, or not expressible in the map's CRS
    heights        text not null check (heights in ('file', 'drives')),
    extent         geometry(Polygon) not null,
    imported_at    timestamptz not null default clock_timestamp(),
    foreign key (map_id, srid) references conetl.map (map_id, srid),
    check (ST_SRID(extent) = srid)
);
create unique index base_source_once on conetl.base_source (map_id, layer_name, content_sha256, md5(params::text));
comment on table conetl.base_source is 'One imported file of a base layer; a layer is all sources of one name.';
comment on column conetl.base_source.heights is
    'file: as the file states them; drives: the file has none, each vertex got the ground height of the nearest pose.';

create table conetl.base_tile (
    -- Deferred: the source is written last, when its counts are known.
    source_id uuid not null references conetl.base_source on delete cascade deferrable initially deferred,
    level     smallint not null check (level between 0 and 9),
    ix        integer not null,
    iy        integer not null,
    points    integer not null check (points > 0),
    origin_m  float8[] not null check (cardinality(origin_m) = 3),
    scale_m   float8[] not null check (cardinality(scale_m) = 3),
    high_m    float8 not null,
    sha256    text not null check (sha256 ~ '^[0-9a-f]{64}$'),
    payload   bytea not null,
    primary key (source_id, level, ix, iy)
);
create index base_tile_by_content on conetl.base_tile (sha256);
alter table conetl.base_tile alter column payload set storage external;  -- it is compressed already
comment on table conetl.base_tile is 'Points of one square and level of detail; tiles of all levels together are the cloud.';

create table conetl.base_line (
    line_id    bigint generated always as identity primary key,
    source_id  uuid not null references conetl.base_source on delete cascade deferrable initially deferred,
    kind       text not null,
    attributes jsonb not null,
    geom       geometry(LineStringZ) not null
);
create index base_line_by_source on conetl.base_line (source_id);
create index base_line_by_place on conetl.base_line using gist (geom);
comment on table conetl.base_line is 'Lane boundaries, markings, kerbs and reference lines; kind is the file''s own word.';
