-- A forecast that the model of a region made for a station is of avalanche days of the region, and judged by these.

ALTER TABLE issued_forecast ADD COLUMN region TEXT REFERENCES region (id);  -- null: of avalanche days of the station
