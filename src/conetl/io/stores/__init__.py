"""The tables of the database: what is written into them and read out of them, a module each. Statements lie in `sql/`."""
