-- Results before this one have no raw frames any more, so they need not be searched for them.
ALTER TABLE store ADD COLUMN first_raw INTEGER NOT NULL DEFAULT 1;

-- The columns that results are counted and listed by, without their records, which are 8 kB each: an index on derived
-- columns does not help, because a query that names one of them reads the whole row.
CREATE TABLE listed (
    seq INTEGER PRIMARY KEY,
    session INTEGER NOT NULL,
    outcome TEXT NOT NULL,
    reason TEXT,
    quality TEXT,
    kind TEXT NOT NULL,
    captured_at TEXT NOT NULL,
    sieve_size_mm REAL
) STRICT;

INSERT INTO listed SELECT seq, session, outcome, reason, quality, kind, captured_at, sieve_size_mm FROM results;

CREATE TRIGGER list_result AFTER INSERT ON results BEGIN
    INSERT INTO listed VALUES (
        NEW.seq, NEW.session, NEW.outcome, NEW.reason, NEW.quality, NEW.kind, NEW.captured_at, NEW.sieve_size_mm
    );
END;

CREATE TRIGGER unlist_result AFTER DELETE ON results BEGIN
    DELETE FROM listed WHERE seq = OLD.seq;
END;

DROP INDEX results_by_outcome;
DROP INDEX results_by_time;
CREATE INDEX listed_by_outcome ON listed (session, outcome, reason, quality);
CREATE INDEX listed_by_time ON listed (captured_at);
