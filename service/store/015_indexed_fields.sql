-- What results are searched, listed and counted by, of their newest revisions: `stones` becomes this table, balls
-- included. `service.store.indexed_fields` fills it and adds further columns. The derived columns of `results` are read no
-- more but by triggers: to drop one would write all records anew.
DROP VIEW measured_stones;
DROP TRIGGER list_result;
DROP TRIGGER list_stone;
DROP TRIGGER unlist_stone;
DROP TRIGGER revise_stone;
DROP INDEX stones_by_time;

ALTER TABLE stones RENAME TO indexed_fields;
ALTER TABLE indexed_fields ADD COLUMN kind TEXT NOT NULL DEFAULT 'particle';
CREATE INDEX indexed_by_time ON indexed_fields (captured_at, outcome, n_stones, kind); -- trends need it alone
CREATE VIEW stones AS SELECT * FROM indexed_fields WHERE kind = 'particle';

-- `revised` names the newest revision, `listed` has what the accounting counts: first results, as they were.
ALTER TABLE revised DROP COLUMN outcome;
ALTER TABLE revised DROP COLUMN quality;
ALTER TABLE revised DROP COLUMN sieve_size_mm;
ALTER TABLE listed DROP COLUMN sieve_size_mm;

CREATE TRIGGER list_result AFTER INSERT ON results BEGIN
    INSERT INTO listed VALUES (
        NEW.seq, NEW.session, NEW.outcome, NEW.reason, NEW.quality, NEW.kind, NEW.captured_at,
        coalesce(NEW.record ->> 'n_stones', 1)
    );
END;

-- Columns that were added, and the first result for which they are not filled yet.
CREATE TABLE unfilled_columns (
    name TEXT PRIMARY KEY,
    from_seq INTEGER NOT NULL
) STRICT;

CREATE TRIGGER revise_result AFTER INSERT ON revisions BEGIN
    INSERT OR REPLACE INTO revised VALUES (NEW.first, NEW.seq);
END;

CREATE TRIGGER unindex_result AFTER DELETE ON results BEGIN
    DELETE FROM indexed_fields WHERE seq = OLD.seq AND lot IS NULL;
END;

CREATE VIEW newest_records AS SELECT results.seq, results.id, lot, coalesce(revisions.record, results.record) AS record
FROM results JOIN triggers USING (trigger)
LEFT JOIN revised ON revised.first = results.seq LEFT JOIN revisions ON revisions.seq = revised.seq;
