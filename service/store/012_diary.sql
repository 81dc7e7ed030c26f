-- What the plant notes of its crusher: a gap that was set, a liner that was changed. Never edited.
CREATE TABLE diary (
    entry INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('gap', 'liner', 'feed', 'other')),
    text TEXT NOT NULL,
    value REAL,
    who TEXT NOT NULL,
    noted_at TEXT NOT NULL
) STRICT;

CREATE INDEX diary_by_time ON diary (at);

-- Trends count the stones of a month by outcome: the index alone tells it.
DROP INDEX stones_by_time;
CREATE INDEX stones_by_time ON stones (captured_at, outcome);
