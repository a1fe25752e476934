-- which service this database is of: an artifact store that another one uses must not be swept
CREATE TABLE instance (
    only_row    INTEGER PRIMARY KEY CHECK (only_row = 1),
    id          TEXT NOT NULL
) STRICT;
