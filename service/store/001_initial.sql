-- One row: the identity of this history and the number of its latest result. `last_seq` is counted here
-- and not taken from the table of results, so that a number is never given twice, whatever is deleted later.
CREATE TABLE store (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    instance_id TEXT NOT NULL,
    last_seq INTEGER NOT NULL DEFAULT 0
) STRICT;

-- One row for each run of the daemon.
CREATE TABLE sessions (
    session INTEGER PRIMARY KEY,
    started_at TEXT NOT NULL,
    info TEXT NOT NULL
) STRICT;

-- One row for each trigger, durable before its bundle is processed. Backgrounds have no outcome.
CREATE TABLE triggers (
    trigger INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions,
    bundle TEXT NOT NULL,
    sequence INTEGER NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('particle', 'ball', 'background')),
    captured_at TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('open', 'measured', 'rejected', 'lost', 'background')),
    UNIQUE (session, bundle),
    CHECK ((kind = 'background') = (state = 'background'))
) STRICT;

CREATE INDEX open_triggers ON triggers (session) WHERE state = 'open';
CREATE INDEX triggers_by_state ON triggers (session, state);

-- The feed: exactly one row for each trigger that ended, never edited. The columns of queries are derived
-- from the record and so cannot contradict it.
CREATE TABLE results (
    seq INTEGER PRIMARY KEY,
    id TEXT NOT NULL UNIQUE,
    trigger INTEGER NOT NULL UNIQUE REFERENCES triggers,
    session INTEGER NOT NULL REFERENCES sessions,
    record TEXT NOT NULL CHECK (json_valid(record)),
    outcome TEXT AS (json_extract(record, '$.outcome')) STORED NOT NULL
        CHECK (outcome IN ('measured', 'rejected', 'lost')),
    reason TEXT AS (json_extract(record, '$.reason')) STORED,
    quality TEXT AS (json_extract(record, '$.quality')) STORED,
    kind TEXT AS (json_extract(record, '$.kind')) STORED NOT NULL,
    captured_at TEXT AS (json_extract(record, '$.captured_at')) STORED NOT NULL,
    sieve_size_mm REAL AS (json_extract(record, '$.sieve_size_mm')) STORED
) STRICT;

CREATE INDEX results_by_outcome ON results (session, outcome, reason, quality);
CREATE INDEX results_by_time ON results (captured_at);
