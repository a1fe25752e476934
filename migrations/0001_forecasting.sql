-- Stations, what was observed there, the models trained from it and the jobs that trained them.
-- Instants are RFC 3339 in UTC, dates are the station's local days, both as text; JSON is text.

CREATE TABLE station (
    id          TEXT PRIMARY KEY,
    name        TEXT NOT NULL,
    latitude    REAL,
    longitude   REAL,
    altitude_m  REAL,
    timezone    TEXT,
    variables   TEXT,                       -- JSON array of names; null: whatever appears
    synthetic   INTEGER NOT NULL DEFAULT 0 CHECK (synthetic IN (0, 1)),
    revision    INTEGER NOT NULL,
    created     TEXT NOT NULL,
    updated     TEXT NOT NULL
) STRICT;

CREATE TABLE observation (
    station                 TEXT NOT NULL REFERENCES station (id),
    date                    TEXT NOT NULL,
    air_temperature         REAL,           -- degC
    wind_speed              REAL,           -- m/s
    wind_direction          REAL,           -- deg
    cloud_cover             REAL,           -- %
    snow_height             REAL,           -- cm
    new_snow_24h            REAL,           -- cm
    new_snow_index          REAL,
    precipitation_24h       REAL,           -- mm
    rain_at_900m            REAL,           -- 0 or 1
    snow_drift              REAL,           -- 0 or 1
    foot_penetration        REAL,           -- cm
    snow_temperature        REAL,           -- degC
    insolation_index        REAL,
    cumulative_snow_index   REAL,
    revision                INTEGER NOT NULL,
    updated                 TEXT NOT NULL,
    PRIMARY KEY (station, date)
) STRICT, WITHOUT ROWID;

-- every state that an observation ever had, with who wrote it and when
CREATE TABLE observation_revision (
    station     TEXT NOT NULL REFERENCES station (id),
    date        TEXT NOT NULL,
    revision    INTEGER NOT NULL,
    body        TEXT NOT NULL,
    recorded    TEXT NOT NULL,
    recorded_by TEXT,
    source      TEXT NOT NULL,
    PRIMARY KEY (station, date, revision)
) STRICT, WITHOUT ROWID;

CREATE TABLE avalanche (
    station     TEXT NOT NULL REFERENCES station (id),
    date        TEXT NOT NULL,
    activity    TEXT NOT NULL CHECK (activity IN ('observed', 'presumed', 'none', 'unknown')),
    count       INTEGER,
    type        TEXT,
    "trigger"   TEXT,
    size        REAL,
    revision    INTEGER NOT NULL,
    updated     TEXT NOT NULL,
    PRIMARY KEY (station, date)
) STRICT, WITHOUT ROWID;

CREATE TABLE avalanche_revision (
    station     TEXT NOT NULL REFERENCES station (id),
    date        TEXT NOT NULL,
    revision    INTEGER NOT NULL,
    body        TEXT NOT NULL,
    recorded    TEXT NOT NULL,
    recorded_by TEXT,
    source      TEXT NOT NULL,
    PRIMARY KEY (station, date, revision)
) STRICT, WITHOUT ROWID;

CREATE TABLE job (
    id           TEXT PRIMARY KEY,
    process_id   TEXT NOT NULL,
    status       TEXT NOT NULL CHECK (status IN ('accepted', 'running', 'successful', 'failed', 'dismissed')),
    progress     INTEGER NOT NULL CHECK (progress BETWEEN 0 AND 100),
    phase        TEXT,
    message      TEXT,
    exception    TEXT,                      -- JSON
    inputs       TEXT NOT NULL,             -- JSON
    input_hash   TEXT NOT NULL,
    results      TEXT,                      -- JSON
    version      TEXT NOT NULL,
    submitted_by TEXT,
    created      TEXT NOT NULL,
    started      TEXT,
    finished     TEXT,
    updated      TEXT NOT NULL
) STRICT;

CREATE INDEX job_by_status ON job (status, id);

CREATE TABLE model (
    id           TEXT PRIMARY KEY,
    station      TEXT NOT NULL REFERENCES station (id),
    job          TEXT NOT NULL,             -- no reference: a finished job may be removed, its model stays
    lead         INTEGER NOT NULL CHECK (lead IN (0, 1)),
    summary      TEXT NOT NULL,             -- JSON: what GET /v1/models/{id} answers
    machine      TEXT NOT NULL,             -- JSON: the trained model
    evaluation   TEXT NOT NULL,             -- JSON
    created      TEXT NOT NULL
) STRICT;

CREATE INDEX model_by_station ON model (station, id);

-- append only: the newest row of a station and lead is the active one
CREATE TABLE activation (
    sequence     INTEGER PRIMARY KEY AUTOINCREMENT,
    station      TEXT NOT NULL REFERENCES station (id),
    lead         INTEGER NOT NULL CHECK (lead IN (0, 1)),
    model        TEXT NOT NULL REFERENCES model (id),
    activated    TEXT NOT NULL,
    activated_by TEXT
) STRICT;

CREATE INDEX activation_by_station ON activation (station, lead, sequence);

CREATE TABLE api_key (
    id        TEXT PRIMARY KEY,             -- the public part of the key
    hash      TEXT NOT NULL,                -- SHA-256 (hex) of the secret part
    name      TEXT NOT NULL,
    role      TEXT NOT NULL CHECK (role IN ('reader', 'forecaster', 'operator', 'admin')),
    created   TEXT NOT NULL,
    expires   TEXT,
    last_used TEXT,
    revoked   TEXT
) STRICT;
