-- Purpose: sorts and joins of an export stay in memory up to this; beyond it they go to the disk. Of the open transaction alone.
set local work_mem = '128MB';
