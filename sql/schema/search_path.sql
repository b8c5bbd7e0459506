-- Purpose: let the session find conetl's tables and PostGIS's functions, in whichever schema PostGIS was installed.
select set_config(
    'search_path',
    'conetl, public' || coalesce((
        select string_agg(distinct ', ' || quote_ident(n.nspname), '')
        from pg_extension e
        join pg_namespace n on n.oid = e.extnamespace
        where e.extname in ('postgis', 'btree_gist') and n.nspname <> 'public'
    ), ''),
    false
) as search_path;
