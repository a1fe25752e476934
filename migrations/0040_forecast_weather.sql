-- Weather of a day to come is a forecast until the day is observed, and a forecast that was made from it is not a nowcast.

ALTER TABLE observation ADD COLUMN forecast INTEGER NOT NULL DEFAULT 0 CHECK (forecast IN (0, 1));

-- what was written before its day began anywhere on Earth (UTC+14 is the first) cannot have been observed
UPDATE observation SET forecast = 1 WHERE date > date(updated, '+14 hours');

-- 'forecast': the weather of the day itself was a forecast when this was issued
CREATE TABLE issued (
    station     TEXT NOT NULL REFERENCES station (id),
    date        TEXT NOT NULL,              -- the day that was forecast
    lead        INTEGER NOT NULL CHECK (lead IN (0, 1)),
    weather     TEXT NOT NULL CHECK (weather IN ('observed', 'forecast')),
    model       TEXT NOT NULL REFERENCES model (id),
    probability REAL NOT NULL,
    warned      INTEGER NOT NULL CHECK (warned IN (0, 1)),
    base_rate   REAL NOT NULL,              -- of the training of the model
    label       TEXT NOT NULL CHECK (label IN ('observed', 'presumed')),
    hindcast    INTEGER NOT NULL CHECK (hindcast IN (0, 1)),
    body        TEXT NOT NULL,              -- JSON: the forecast as it was answered
    similar     TEXT NOT NULL,              -- JSON: the past days that were nearest to it
    issued      TEXT NOT NULL,
    issued_by   TEXT,
    PRIMARY KEY (station, date, lead, weather),
    CHECK (weather = 'observed' OR lead = 1)
) STRICT, WITHOUT ROWID;

INSERT INTO issued
SELECT station, date, lead, 'observed', model, probability, warned, base_rate, label, hindcast, body, '[]', issued, issued_by
FROM issued_forecast;

DROP TABLE issued_forecast;
ALTER TABLE issued RENAME TO issued_forecast;

CREATE TRIGGER issued_forecast_is_frozen BEFORE UPDATE ON issued_forecast
BEGIN
    SELECT RAISE(ABORT, 'an issued forecast is never changed');
END;
