-- A work zone is computed from the history of its devices, and its id from the first ones: a drive that comes late may find others.
-- The zone then keeps the id under which its versions are stored (conetl.notice).

create table conetl.zone_alias (
    map_id      integer not null references conetl.map (map_id) on delete cascade,
    computed_id uuid not null,
    zone_id     uuid not null check (zone_id <> computed_id),
    recorded_at timestamptz not null default now(),
    primary key (map_id, computed_id)
);
comment on table conetl.zone_alias is 'Work zones that were known under another id before their first devices became others.';
comment on column conetl.zone_alias.computed_id is 'As it follows from the devices that are first now.';
comment on column conetl.zone_alias.zone_id is 'The one that it keeps.';
