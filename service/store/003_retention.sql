-- Results before `first_seq` are no longer in the feed; `files_bytes` is the sum over `files`, kept by the triggers below.
ALTER TABLE store ADD COLUMN first_seq INTEGER NOT NULL DEFAULT 1;
ALTER TABLE store ADD COLUMN files_bytes INTEGER NOT NULL DEFAULT 0;

-- Where the files of each measured or rejected result are, below `particles`, and their size without frames. They are to
-- be removed as soon as `removed` says why; when they are gone from the disk, `bytes` is NULL.
CREATE TABLE files (
    seq INTEGER PRIMARY KEY REFERENCES results ON DELETE CASCADE,
    folder TEXT NOT NULL,
    bytes INTEGER,
    removed TEXT CHECK (removed IN ('age', 'space'))
) STRICT;

CREATE INDEX files_kept ON files (seq) WHERE removed IS NULL;
CREATE INDEX files_going ON files (seq) WHERE removed IS NOT NULL AND bytes IS NOT NULL;

CREATE TRIGGER add_files AFTER INSERT ON files BEGIN
    UPDATE store SET files_bytes = files_bytes + NEW.bytes;
END;

CREATE TRIGGER subtract_files AFTER UPDATE OF bytes ON files BEGIN
    UPDATE store SET files_bytes = files_bytes + coalesce(NEW.bytes, 0) - coalesce(OLD.bytes, 0);
END;

-- Results whose files and row are kept whatever their age.
CREATE TABLE pins (
    seq INTEGER PRIMARY KEY REFERENCES results,
    reason TEXT NOT NULL
) STRICT;

-- How far each named client has read the feed.
CREATE TABLE consumers (
    name TEXT PRIMARY KEY,
    after_seq INTEGER NOT NULL,
    moved_at TEXT NOT NULL
) STRICT;

-- Counts of the results that were removed: the accounting never forgets.
CREATE TABLE removed_results (
    session INTEGER NOT NULL,
    outcome TEXT NOT NULL,
    reason TEXT NOT NULL,
    quality TEXT NOT NULL,
    n INTEGER NOT NULL,
    PRIMARY KEY (session, outcome, reason, quality)
) STRICT;

CREATE TRIGGER count_removed AFTER DELETE ON results BEGIN
    INSERT INTO removed_results
        VALUES (OLD.session, OLD.outcome, coalesce(OLD.reason, ''), coalesce(OLD.quality, ''), 1)
        ON CONFLICT DO UPDATE SET n = n + 1;
    DELETE FROM triggers WHERE trigger = OLD.trigger;
END;

-- Earlier versions kept all folders side by side, with a mesh of about this size in each.
INSERT INTO files SELECT seq, id, iif(listed.outcome = 'measured', 900000, 50000), NULL
    FROM results JOIN listed USING (seq) WHERE listed.outcome != 'lost';
