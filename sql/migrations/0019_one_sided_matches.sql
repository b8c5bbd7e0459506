-- An object that the network found in one image only is located too: the other image was searched for what the box shows.

alter table conetl.stereo_match
    alter column left_detection_index drop not null,
    alter column right_detection_index drop not null;
comment on column conetl.stereo_match.left_detection_index is 'Null where the network found the object in the right image only.';
comment on column conetl.stereo_match.right_detection_index is 'Null where the network found the object in the left image only.';
