-- Retraining proposes and never replaces: a new model beside the comparison with the active one, for a person to decide.

ALTER TABLE station ADD COLUMN retrain TEXT;    -- MM-DD on which it is retrained each year; null: on request
ALTER TABLE region ADD COLUMN retrain TEXT;

CREATE TABLE proposal (
    id             TEXT PRIMARY KEY,
    station        TEXT REFERENCES station (id),
    region         TEXT REFERENCES region (id),
    lead           INTEGER NOT NULL CHECK (lead IN (0, 1)),
    job            TEXT NOT NULL,                           -- no reference: a finished job may be removed
    model          TEXT NOT NULL REFERENCES model (id),     -- what is proposed
    active         TEXT NOT NULL REFERENCES model (id),     -- what it was compared with
    status         TEXT NOT NULL CHECK (status IN ('open', 'accepted', 'declined', 'superseded')),
    recommendation TEXT NOT NULL,
    comparison     TEXT,                                    -- JSON
    created        TEXT NOT NULL,
    decided        TEXT,
    decided_by     TEXT,
    reason         TEXT,
    CHECK ((station IS NULL) <> (region IS NULL))
) STRICT;

CREATE INDEX proposal_by_place ON proposal (station, region, id);

-- days of the calendar on which a retraining was due and taken up: one row is one job, or the reason why there is none
CREATE TABLE retraining (
    place   TEXT NOT NULL,                  -- its address
    lead    INTEGER NOT NULL CHECK (lead IN (0, 1)),
    due     TEXT NOT NULL,                  -- the local day
    job     TEXT,
    refusal TEXT,
    at      TEXT NOT NULL,
    PRIMARY KEY (place, lead, due)
) STRICT, WITHOUT ROWID;
