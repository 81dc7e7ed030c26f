-- Form of each stone, and why its quality is not good (a list in JSON): stones are looked for by them.
ALTER TABLE stones ADD COLUMN zingg_class TEXT;
ALTER TABLE stones ADD COLUMN quality_causes TEXT;

UPDATE stones SET zingg_class = record ->> 'zingg_class', quality_causes = record -> 'quality_causes'
    FROM results WHERE results.seq = stones.seq;
UPDATE stones SET zingg_class = record ->> 'zingg_class', quality_causes = record -> 'quality_causes'
    FROM revised JOIN revisions USING (seq) WHERE revised.first = stones.seq;

DROP VIEW measured_stones;
CREATE VIEW measured_stones AS SELECT
    seq, results.id, lot, results.captured_at, outcome, reason, quality, record ->> 'volume_mm3', results.sieve_size_mm,
    record ->> 'max_feret_mm', record ->> 'min_feret_mm', record ->> 'length_mm', record ->> 'width_mm',
    record ->> 'thickness_mm', record ->> 'volume_sd_percent', record ->> 'surface_sd_mm',
    record ->> 'calibration_id', record ->> 'algorithm_version', record ->> 'is_simulated', record ->> 'is_replay',
    record ->> 'body', record ->> 'refinement_fallback', record ->> 'zingg_class', record -> 'quality_causes'
FROM results JOIN triggers USING (trigger) WHERE results.kind = 'particle';

DROP TRIGGER revise_stone;
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
        algorithm_version = NEW.record ->> 'algorithm_version',
        body = NEW.record ->> 'body',
        refinement_fallback = NEW.record ->> 'refinement_fallback',
        zingg_class = NEW.record ->> 'zingg_class',
        quality_causes = NEW.record -> 'quality_causes'
    WHERE seq = NEW.first;
END;
