-- Pieces of outputs that a running job has handed over: their bytes lie in the artifact store under their digest. Its end
-- puts them together, and they go.

CREATE TABLE job_piece (
    job    TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    sha256 TEXT NOT NULL,
    PRIMARY KEY (job, sha256)
) STRICT, WITHOUT ROWID;
