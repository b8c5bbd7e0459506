-- Raw records of old drives may be moved to Parquet files, from which they come back when a comparison needs them.

alter table conetl.drive add column archive_path text check (archive_path is null or pruned_at is not null);
comment on column conetl.drive.archive_path is
    'Folder of the Parquet files to which its raw records were moved at pruned_at; null: they are in the tables, or were deleted.';
