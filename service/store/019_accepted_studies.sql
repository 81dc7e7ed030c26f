-- A correlation study is a draft until it is accepted; those made before were in use at once.
ALTER TABLE correlations ADD COLUMN state TEXT NOT NULL DEFAULT 'accepted'
    CHECK (state IN ('draft', 'accepted', 'withdrawn'));
ALTER TABLE correlations ADD COLUMN obstacles TEXT NOT NULL DEFAULT '[]' CHECK (json_valid(obstacles));
ALTER TABLE correlations ADD COLUMN accepted_at TEXT;
ALTER TABLE correlations ADD COLUMN accepted_by TEXT;
ALTER TABLE correlations ADD COLUMN withdrawn_at TEXT;
ALTER TABLE correlations ADD COLUMN reason TEXT;
UPDATE correlations SET accepted_at = at;
