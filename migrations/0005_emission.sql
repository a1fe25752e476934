-- Data sets of acoustic emission: their columns lie in the artifact store under their digest.

CREATE TABLE dataset (
    id          TEXT PRIMARY KEY,
    name        TEXT NOT NULL,
    metadata    TEXT NOT NULL,                  -- JSON
    description TEXT NOT NULL,                  -- JSON: columns, quality, source
    truth       TEXT,                           -- JSON; null: measured, not made by a generator
    job         TEXT,                           -- no reference: a finished job may be removed, its data set stays
    sha256      TEXT NOT NULL,
    size        INTEGER NOT NULL,
    revision    INTEGER NOT NULL,
    created     TEXT NOT NULL,
    created_by  TEXT,
    updated     TEXT NOT NULL
) STRICT;

CREATE INDEX dataset_by_sha256 ON dataset (sha256);
