-- Of how many stones a row tells: more than one only for losses that the gate's counter knows, as those of a weekend
-- without a daemon. Triggers and results are counted by it each for themselves, so that the balance stays a check.
ALTER TABLE triggers ADD COLUMN n INTEGER NOT NULL DEFAULT 1 CHECK (n > 0);
ALTER TABLE listed ADD COLUMN n INTEGER NOT NULL DEFAULT 1;
ALTER TABLE stones ADD COLUMN n_stones INTEGER NOT NULL DEFAULT 1;

DROP TRIGGER list_result;
CREATE TRIGGER list_result AFTER INSERT ON results BEGIN
    INSERT INTO listed VALUES (
        NEW.seq, NEW.session, NEW.outcome, NEW.reason, NEW.quality, NEW.kind, NEW.captured_at, NEW.sieve_size_mm,
        coalesce(NEW.record ->> 'n_stones', 1)
    );
END;

DROP TRIGGER count_removed;
CREATE TRIGGER count_removed AFTER DELETE ON results BEGIN
    INSERT INTO removed_results VALUES (
        OLD.session, OLD.outcome, coalesce(OLD.reason, ''), coalesce(OLD.quality, ''),
        coalesce(OLD.record ->> 'n_stones', 1)
    )
        ON CONFLICT DO UPDATE SET n = n + excluded.n;
    DELETE FROM triggers WHERE trigger = OLD.trigger;
END;

DROP VIEW measured_stones;
CREATE VIEW measured_stones AS SELECT
    seq, results.id, lot, results.captured_at, outcome, reason, quality, record ->> 'volume_mm3', results.sieve_size_mm,
    record ->> 'max_feret_mm', record ->> 'min_feret_mm', record ->> 'length_mm', record ->> 'width_mm',
    record ->> 'thickness_mm', record ->> 'volume_sd_percent', record ->> 'surface_sd_mm',
    record ->> 'calibration_id', record ->> 'algorithm_version', record ->> 'is_simulated', record ->> 'is_replay',
    record ->> 'body', record ->> 'refinement_fallback', record ->> 'zingg_class', record -> 'quality_causes',
    coalesce(record ->> 'n_stones', 1)
FROM results JOIN triggers USING (trigger) WHERE results.kind = 'particle';

-- The accounting and trends count by these indexes alone.
DROP INDEX triggers_by_state;
CREATE INDEX triggers_by_state ON triggers (session, state, n);
DROP INDEX open_triggers;
CREATE INDEX open_triggers ON triggers (trigger, session, n) WHERE state = 'open';
DROP INDEX listed_by_outcome;
CREATE INDEX listed_by_outcome ON listed (session, outcome, reason, quality, n);
DROP INDEX stones_by_time;
CREATE INDEX stones_by_time ON stones (captured_at, outcome, n_stones);
