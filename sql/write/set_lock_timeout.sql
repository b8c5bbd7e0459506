-- Purpose: how long this transaction waits for a lock. Parameters: timeout (for example '600s').
select set_config('lock_timeout', %(timeout)s, true);
