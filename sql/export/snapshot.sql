-- Purpose: everything that the open transaction reads is one state of the database. Must come before its first query.
set transaction isolation level repeatable read, read only;
