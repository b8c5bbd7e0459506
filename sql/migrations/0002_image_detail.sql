-- Fine structure that the images of a frame pair show: without it they are no evidence that a cone is gone.

alter table conetl.frame_pair add column detail float8;
comment on column conetl.frame_pair.detail is
    'fine structure of its images in grey levels, the smaller of both; null where it was not measured';
