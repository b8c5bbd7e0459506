-- Each commit asks which drives of the map were recorded right before and after its own.

create index drive_by_begin on conetl.drive (map_id, captured_from_ns);
create index drive_by_end on conetl.drive (map_id, captured_to_ns);
