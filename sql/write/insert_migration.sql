-- Purpose: remember an applied migration. Parameters: name, sha256 (hex of the file).
insert into conetl.schema_migration (name, sha256) values (%(name)s, %(sha256)s);
