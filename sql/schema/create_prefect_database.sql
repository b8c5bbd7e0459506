-- Purpose: a database of its own for the Prefect server, beside the map's. Needs the right to create databases.
create database prefect;
