-- Regions: several stations that feed one model. A model, its activation and a selection of features belong to a station or to
-- a region, so their tables are made anew; those that refer to them go along. Who did what is kept in an audit.

CREATE TABLE region (
    id              TEXT PRIMARY KEY,
    name            TEXT NOT NULL,
    stations_needed INTEGER NOT NULL CHECK (stations_needed >= 1),  -- with an avalanche, for an avalanche day of the region
    quiet           TEXT NOT NULL CHECK (quiet IN ('every_station', 'any_station')),
    revision        INTEGER NOT NULL,
    created         TEXT NOT NULL,
    updated         TEXT NOT NULL
) STRICT;

CREATE TABLE region_station (
    region   TEXT NOT NULL REFERENCES region (id),
    station  TEXT NOT NULL REFERENCES station (id),
    position INTEGER NOT NULL,
    PRIMARY KEY (region, station)
) STRICT, WITHOUT ROWID;

CREATE INDEX region_station_by_station ON region_station (station, region);

DROP INDEX model_by_station;
DROP INDEX activation_by_station;
-- what refers to a table follows its new name, until it is made anew itself
ALTER TABLE selection RENAME TO selection_before;
ALTER TABLE model RENAME TO model_before;

CREATE TABLE selection (
    job     TEXT PRIMARY KEY,               -- no reference: a finished job may be removed, what it found stays
    station TEXT REFERENCES station (id),
    region  TEXT REFERENCES region (id),
    body    TEXT NOT NULL,                  -- JSON: the results of the job
    created TEXT NOT NULL,
    CHECK ((station IS NULL) <> (region IS NULL))
) STRICT;

INSERT INTO selection (job, station, body, created) SELECT job, station, body, created FROM selection_before;

CREATE TABLE model (
    id         TEXT PRIMARY KEY,
    station    TEXT REFERENCES station (id),
    region     TEXT REFERENCES region (id),
    job        TEXT NOT NULL,               -- no reference: a finished job may be removed, its model stays
    lead       INTEGER NOT NULL CHECK (lead IN (0, 1)),
    selection  TEXT REFERENCES selection (job),
    summary    TEXT NOT NULL,               -- JSON: what GET /v1/models/{id} answers
    machine    TEXT NOT NULL,               -- JSON: the trained model
    evaluation TEXT NOT NULL,               -- JSON
    created    TEXT NOT NULL,
    CHECK ((station IS NULL) <> (region IS NULL))
) STRICT;

INSERT INTO model (id, station, job, lead, selection, summary, machine, evaluation, created)
    SELECT id, station, job, lead, selection, summary, machine, evaluation, created FROM model_before;

CREATE INDEX model_by_place ON model (station, region, id);

-- append only: the newest row of a place and lead is the active one
CREATE TABLE activation_anew (
    sequence     INTEGER PRIMARY KEY AUTOINCREMENT,
    station      TEXT REFERENCES station (id),
    region       TEXT REFERENCES region (id),
    lead         INTEGER NOT NULL CHECK (lead IN (0, 1)),
    model        TEXT NOT NULL REFERENCES model (id),
    activated    TEXT NOT NULL,
    activated_by TEXT,
    reason       TEXT,
    back_to      INTEGER,                   -- the activation that a roll-back from here restores
    CHECK ((station IS NULL) <> (region IS NULL))
) STRICT;

INSERT INTO activation_anew (sequence, station, lead, model, activated, activated_by, back_to)
    SELECT sequence, station, lead, model, activated, activated_by,
           lag(sequence) OVER (PARTITION BY station, lead ORDER BY sequence)
    FROM activation;

DROP TABLE activation;
ALTER TABLE activation_anew RENAME TO activation;
CREATE INDEX activation_by_place ON activation (station, region, lead, sequence);

CREATE TABLE issued_forecast_anew (
    station     TEXT NOT NULL REFERENCES station (id),
    date        TEXT NOT NULL,              -- the day that was forecast
    lead        INTEGER NOT NULL CHECK (lead IN (0, 1)),
    model       TEXT NOT NULL REFERENCES model (id),
    probability REAL NOT NULL,
    warned      INTEGER NOT NULL CHECK (warned IN (0, 1)),
    base_rate   REAL NOT NULL,              -- of the training of the model
    label       TEXT NOT NULL CHECK (label IN ('observed', 'presumed')),
    hindcast    INTEGER NOT NULL CHECK (hindcast IN (0, 1)),
    body        TEXT NOT NULL,              -- JSON: the forecast as it was answered
    issued      TEXT NOT NULL,
    issued_by   TEXT,
    PRIMARY KEY (station, date, lead)
) STRICT, WITHOUT ROWID;

INSERT INTO issued_forecast_anew
    (station, date, lead, model, probability, warned, base_rate, label, hindcast, body, issued, issued_by)
    SELECT station, date, lead, model, probability, warned, base_rate, label, hindcast, body, issued, issued_by
    FROM issued_forecast;

DROP TABLE issued_forecast;
ALTER TABLE issued_forecast_anew RENAME TO issued_forecast;

CREATE TRIGGER issued_forecast_is_frozen BEFORE UPDATE ON issued_forecast
BEGIN
    SELECT RAISE(ABORT, 'an issued forecast is never changed');
END;

DROP TABLE model_before;
DROP TABLE selection_before;

-- how models did at other places
CREATE TABLE transfer (
    job     TEXT PRIMARY KEY,               -- no reference: a finished job may be removed, what it found stays
    model   TEXT NOT NULL REFERENCES model (id),
    station TEXT NOT NULL REFERENCES station (id),
    body    TEXT NOT NULL,                  -- JSON: the results of the job
    created TEXT NOT NULL
) STRICT;

CREATE INDEX transfer_by_model ON transfer (model, job);

CREATE TABLE audit (
    sequence INTEGER PRIMARY KEY AUTOINCREMENT,
    at       TEXT NOT NULL,
    who      TEXT,                          -- name of the key; null: no key was needed, or the service itself
    action   TEXT NOT NULL,
    target   TEXT NOT NULL,                 -- its address below /v1, or key:ID
    reason   TEXT,
    before   TEXT,                          -- JSON
    after    TEXT,                          -- JSON
    trace_id TEXT
) STRICT;

CREATE INDEX audit_by_target ON audit (target, sequence);

CREATE TRIGGER audit_is_kept_unchanged BEFORE UPDATE ON audit
BEGIN
    SELECT RAISE(ABORT, 'the audit is never changed');
END;

CREATE TRIGGER audit_is_kept BEFORE DELETE ON audit
BEGIN
    SELECT RAISE(ABORT, 'the audit is never shortened');
END;
