-- JSON of the outputs that a job was asked for, and how they are answered; null: all of them in one document
ALTER TABLE job ADD COLUMN wanted TEXT;
