-- The OGC API names its columns as the exported files do (docs/reference/fields.md): one name has one meaning everywhere.

do $$
declare
    names constant jsonb = '{
        "height_m": "ellipsoidal_height_m", "old_height_m": "old_ellipsoidal_height_m",
        "cone_height_m": "object_height_m", "cone_height_sigma_m": "height_sigma_m",
        "sigma_east_m": "sigma_e_m", "sigma_north_m": "sigma_n_m", "sigma_height_m": "sigma_u_m", "cov_xy_m2": "cov_en_m2",
        "kind": "change"
    }';
    renamed record;
    old record;
    head text;
    body text;
begin
    -- PostgreSQL does not rename the columns that a function returns: it is made again with another head.
    for old in
        select p.oid::regprocedure::text as signature, pg_get_functiondef(p.oid) as definition, obj_description(p.oid) as remark
        from pg_proc p
        where p.pronamespace = 'conetl_ogc'::regnamespace and p.proname in ('standing', 'features', 'changes')
        order by p.proname = 'features'  -- which reads the columns of standing
    loop
        head = split_part(old.definition, ' LANGUAGE ', 1);
        body = substr(old.definition, length(head) + 1);
        for renamed in select key as old_name, value as new_name from jsonb_each_text(names) loop
            head = regexp_replace(head, format('([(,] )%s ', renamed.old_name), format('\1%s ', renamed.new_name), 'g');
            body = regexp_replace(body, format('\ms\.%s\M', renamed.old_name), format('s.%s', renamed.new_name), 'g');
        end loop;
        execute format('drop function %s', old.signature);
        execute head || body;
        execute format('comment on function %s is %L', old.signature, old.remark);
    end loop;
end
$$;
