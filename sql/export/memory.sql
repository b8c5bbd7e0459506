-- Purpose: how much memory each sort and each join of an export may take (a join twice that); beyond it they go to the disk.
-- Of the open transaction alone. Parameters: work_mem (for example '64MB').
set local work_mem = %(work_mem)s;
