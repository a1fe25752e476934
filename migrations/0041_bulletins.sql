-- The region that a bulletin is for, as the European avalanche warning services name it.
ALTER TABLE station ADD COLUMN eaws_region TEXT;
