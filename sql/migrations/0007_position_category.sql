-- Positions have the class of their object: drives search for other objects than cones, too.
alter table conetl.position add column category text not null default 'traffic_cone';
alter table conetl.position alter column category drop default;
