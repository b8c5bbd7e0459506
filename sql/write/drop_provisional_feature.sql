-- Purpose: take back a cone that the drive being watched does not show any more. Parameters: watch_id, feature_index.
delete from conetl.provisional_feature where watch_id = %(watch_id)s and feature_index = %(feature_index)s;
