-- A sieving that was wrong stays, and counts no more; `replaced_by` is the corrected one.
ALTER TABLE sievings ADD COLUMN voided_at TEXT;
ALTER TABLE sievings ADD COLUMN void_reason TEXT;
ALTER TABLE sievings ADD COLUMN replaced_by INTEGER REFERENCES sievings;
