-- Jobs that nobody loses: attempts with a lease each, checkpoints, children, events, a log, and keys that make a repeated
-- request harmless. Instants in `_ms` are milliseconds since 1970 in UTC, so that leases compare as numbers.

ALTER TABLE job ADD COLUMN attempt INTEGER NOT NULL DEFAULT 0;
ALTER TABLE job ADD COLUMN lost INTEGER NOT NULL DEFAULT 0;             -- attempts in a row that ended without a word
ALTER TABLE job ADD COLUMN priority INTEGER NOT NULL DEFAULT 5 CHECK (priority BETWEEN 0 AND 9);
ALTER TABLE job ADD COLUMN labels TEXT NOT NULL DEFAULT '{}';           -- JSON object of texts
ALTER TABLE job ADD COLUMN parent TEXT REFERENCES job (id) ON DELETE CASCADE;
ALTER TABLE job ADD COLUMN position INTEGER;                            -- place among the children of its parent
ALTER TABLE job ADD COLUMN waits_for_children INTEGER NOT NULL DEFAULT 0 CHECK (waits_for_children IN (0, 1));
ALTER TABLE job ADD COLUMN worker TEXT;
ALTER TABLE job ADD COLUMN lease_until_ms INTEGER NOT NULL DEFAULT 0;
ALTER TABLE job ADD COLUMN ticketed_ms INTEGER NOT NULL DEFAULT 0;      -- when its newest ticket went to the engine
ALTER TABLE job ADD COLUMN rate REAL;
ALTER TABLE job ADD COLUMN rate_unit TEXT;
ALTER TABLE job ADD COLUMN eta_seconds REAL;
ALTER TABLE job ADD COLUMN compute_ms INTEGER NOT NULL DEFAULT 0;       -- over all attempts

CREATE INDEX job_by_parent ON job (parent, position) WHERE parent IS NOT NULL;
CREATE INDEX job_by_input ON job (input_hash, process_id) WHERE status = 'successful';

CREATE TABLE job_checkpoint (
    job      TEXT PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    attempt  INTEGER NOT NULL,
    made     TEXT NOT NULL,
    bytes    BLOB NOT NULL,
    progress INTEGER NOT NULL                                           -- of the attempt when it was saved
) STRICT;

CREATE TABLE job_event (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    job      TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    kind     TEXT NOT NULL,
    body     TEXT NOT NULL                                              -- JSON
) STRICT;

CREATE INDEX job_event_by_job ON job_event (job, sequence);

CREATE TABLE job_log (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    job      TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt  INTEGER NOT NULL,
    at       TEXT NOT NULL,
    level    TEXT NOT NULL,
    message  TEXT NOT NULL
) STRICT;

CREATE INDEX job_log_by_job ON job_log (job, sequence);

-- large outputs: the bytes lie in the artifact store under their digest
CREATE TABLE job_output (
    job        TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    name       TEXT NOT NULL,
    media_type TEXT NOT NULL,
    size       INTEGER NOT NULL,
    sha256     TEXT NOT NULL,
    PRIMARY KEY (job, name)
) STRICT, WITHOUT ROWID;

CREATE TABLE idempotency (
    caller       TEXT NOT NULL,
    key          TEXT NOT NULL,
    request_hash TEXT NOT NULL,
    answer       TEXT,                                                  -- JSON; null while the first request is at work
    created_ms   INTEGER NOT NULL,
    PRIMARY KEY (caller, key)
) STRICT, WITHOUT ROWID;
