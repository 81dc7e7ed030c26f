-- What is produced and what it must be; each change is another version.
CREATE TABLE products (
    product TEXT NOT NULL,
    version INTEGER NOT NULL,
    definition TEXT NOT NULL CHECK (json_valid(definition)),
    created_at TEXT NOT NULL,
    PRIMARY KEY (product, version)
) STRICT;

-- Stones that belong together; what fell between opening and closing, or was assigned later.
CREATE TABLE lots (
    lot TEXT PRIMARY KEY,
    state TEXT NOT NULL CHECK (state IN ('open', 'closed', 'void')),
    product TEXT NOT NULL,
    version INTEGER NOT NULL,
    definition TEXT NOT NULL CHECK (json_valid(definition)),
    opened_at TEXT NOT NULL,
    closed_at TEXT,
    void_reason TEXT,
    FOREIGN KEY (product, version) REFERENCES products
) STRICT;

CREATE UNIQUE INDEX one_open_lot ON lots (state) WHERE state = 'open';

-- The lot that was open when the stone fell, whenever it is measured.
ALTER TABLE triggers ADD COLUMN lot TEXT REFERENCES lots;

-- What a gradation needs of each stone: the records of ten thousand are 90 MB, these columns 2 MB. Those of a lot outlive
-- their results.
CREATE TABLE stones (
    seq INTEGER PRIMARY KEY,
    id TEXT NOT NULL,
    lot TEXT REFERENCES lots,
    captured_at TEXT NOT NULL,
    outcome TEXT NOT NULL,
    reason TEXT,
    quality TEXT,
    volume_mm3 REAL,
    sieve_size_mm REAL,
    max_feret_mm REAL,
    min_feret_mm REAL,
    length_mm REAL,
    width_mm REAL,
    thickness_mm REAL,
    volume_sd_percent REAL,
    surface_sd_mm REAL,
    calibration_id TEXT,
    algorithm_version TEXT,
    is_simulated INTEGER,
    is_replay INTEGER
) STRICT;

CREATE INDEX stones_by_lot ON stones (lot) WHERE lot IS NOT NULL;
CREATE INDEX stones_by_time ON stones (captured_at);

CREATE VIEW measured_stones AS SELECT
    seq, results.id, lot, results.captured_at, outcome, reason, quality, record ->> 'volume_mm3', results.sieve_size_mm,
    record ->> 'max_feret_mm', record ->> 'min_feret_mm', record ->> 'length_mm', record ->> 'width_mm',
    record ->> 'thickness_mm', record ->> 'volume_sd_percent', record ->> 'surface_sd_mm',
    record ->> 'calibration_id', record ->> 'algorithm_version', record ->> 'is_simulated', record ->> 'is_replay'
FROM results JOIN triggers USING (trigger) WHERE results.kind = 'particle';

INSERT INTO stones SELECT * FROM measured_stones;

CREATE TRIGGER list_stone AFTER INSERT ON results BEGIN
    INSERT INTO stones SELECT * FROM measured_stones WHERE seq = NEW.seq;
END;

CREATE TRIGGER unlist_stone AFTER DELETE ON results BEGIN
    DELETE FROM stones WHERE seq = OLD.seq AND lot IS NULL;
END;

-- Who changed what; never edited.
CREATE TABLE audit (
    entry INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    who TEXT NOT NULL,
    action TEXT NOT NULL,
    subject TEXT NOT NULL,
    before TEXT,
    after TEXT
) STRICT;

CREATE TRIGGER audit_is_not_edited BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'the audit is never edited'); END;
CREATE TRIGGER audit_is_not_deleted BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'the audit is never edited'); END;

-- What the laboratory found in portions of a lot, and how its sieves and this instrument agree for a product.
CREATE TABLE sievings (
    sieving INTEGER PRIMARY KEY,
    lot TEXT NOT NULL REFERENCES lots,
    at TEXT NOT NULL,
    document TEXT NOT NULL CHECK (json_valid(document))
) STRICT;

CREATE TABLE correlations (
    product TEXT NOT NULL,
    version INTEGER NOT NULL,
    at TEXT NOT NULL,
    document TEXT NOT NULL CHECK (json_valid(document)),
    PRIMARY KEY (product, version)
) STRICT;
