-- How many features it takes: kept beside the job that found it, and named by the models that were trained with it.

CREATE TABLE selection (
    job     TEXT PRIMARY KEY,               -- no reference: a finished job may be removed, what it found stays
    station TEXT NOT NULL REFERENCES station (id),
    body    TEXT NOT NULL,                  -- JSON: the results of the job
    created TEXT NOT NULL
) STRICT;

ALTER TABLE model ADD COLUMN selection TEXT REFERENCES selection (job);
