-- Shifts that have ended since the first start with this table: each is told of once, and its sheet written once to the
-- folder of [file_drop]. The first row is the shift before that start, of which nothing is told.
CREATE TABLE ended_shifts (
    shift TEXT PRIMARY KEY,
    since TEXT NOT NULL,
    until TEXT NOT NULL,
    dropped_at TEXT
) STRICT;
