-- Corrections of results: each is a later item of the feed that tells the same stone anew; `first` is the stone's own
-- result, which stays as it is, as does the accounting. Its files are in the folder `r<revision>` within the first's.
CREATE TABLE revisions (
    seq INTEGER PRIMARY KEY,
    first INTEGER NOT NULL REFERENCES results ON DELETE CASCADE,
    revision INTEGER NOT NULL CHECK (revision > 1),
    record TEXT NOT NULL CHECK (json_valid(record)),
    UNIQUE (first, revision)
) STRICT;

CREATE INDEX revisions_by_commit ON revisions (json_extract(record, '$.recorded_at'));

-- The newest revision of each stone that has one, and what the stone is listed by since.
CREATE TABLE revised (
    first INTEGER PRIMARY KEY REFERENCES results ON DELETE CASCADE,
    seq INTEGER NOT NULL,
    outcome TEXT NOT NULL CHECK (outcome IN ('measured', 'rejected')),
    quality TEXT,
    sieve_size_mm REAL
) STRICT;

CREATE TRIGGER revise_stone AFTER INSERT ON revisions BEGIN
    INSERT OR REPLACE INTO revised VALUES (
        NEW.first, NEW.seq, NEW.record ->> 'outcome', NEW.record ->> 'quality', NEW.record ->> 'sieve_size_mm'
    );
    UPDATE stones SET
        outcome = NEW.record ->> 'outcome',
        reason = NEW.record ->> 'reason',
        quality = NEW.record ->> 'quality',
        volume_mm3 = NEW.record ->> 'volume_mm3',
        sieve_size_mm = NEW.record ->> 'sieve_size_mm',
        max_feret_mm = NEW.record ->> 'max_feret_mm',
        min_feret_mm = NEW.record ->> 'min_feret_mm',
        length_mm = NEW.record ->> 'length_mm',
        width_mm = NEW.record ->> 'width_mm',
        thickness_mm = NEW.record ->> 'thickness_mm',
        volume_sd_percent = NEW.record ->> 'volume_sd_percent',
        surface_sd_mm = NEW.record ->> 'surface_sd_mm',
        calibration_id = NEW.record ->> 'calibration_id',
        algorithm_version = NEW.record ->> 'algorithm_version'
    WHERE seq = NEW.first;
END;
