-- What a job was spent on, over all its attempts, and when its newest attempt began: of one that is lost without a word the
-- computing time is what lay between that and its last sign of life.

ALTER TABLE job ADD COLUMN claimed_ms INTEGER NOT NULL DEFAULT 0;       -- when its newest attempt began
ALTER TABLE job ADD COLUMN states INTEGER NOT NULL DEFAULT 0;           -- saved to go on from
ALTER TABLE job ADD COLUMN saving_ms INTEGER NOT NULL DEFAULT 0;        -- computing that stood still to save them
ALTER TABLE job ADD COLUMN storing_ms INTEGER NOT NULL DEFAULT 0;       -- storing them beside the computing
