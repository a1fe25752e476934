-- What was said in service: forecasts as they were issued, and the forecaster's own calls. Neither is ever changed afterwards.

CREATE TABLE issued_forecast (
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

CREATE TRIGGER issued_forecast_is_frozen BEFORE UPDATE ON issued_forecast
BEGIN
    SELECT RAISE(ABORT, 'an issued forecast is never changed');
END;

CREATE TABLE forecaster_call (
    station      TEXT NOT NULL REFERENCES station (id),
    date         TEXT NOT NULL,
    lead         INTEGER NOT NULL CHECK (lead IN (0, 1)),
    warned       INTEGER NOT NULL CHECK (warned IN (0, 1)),
    probability  REAL,
    danger_level INTEGER CHECK (danger_level BETWEEN 1 AND 5),
    note         TEXT,
    hindcast     INTEGER NOT NULL CHECK (hindcast IN (0, 1)),
    revision     INTEGER NOT NULL,
    made         TEXT NOT NULL,
    made_by      TEXT,
    PRIMARY KEY (station, date, lead)
) STRICT, WITHOUT ROWID;
