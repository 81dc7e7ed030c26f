-- Why a correlation study cannot be accepted, as codes with their parameters, beside the same in words.
ALTER TABLE correlations ADD COLUMN findings TEXT CHECK (findings IS NULL OR json_valid(findings));
