-- What was said of a closed lot once all its stones had outcomes, and of which of its revisions. Lots that earlier versions
-- closed count as completed, and nothing was said of them.
ALTER TABLE lots ADD COLUMN completed_revision INTEGER NOT NULL DEFAULT 0;
ALTER TABLE lots ADD COLUMN completion TEXT CHECK (completion IS NULL OR json_valid(completion));
UPDATE lots SET completed_revision = revision WHERE state = 'closed';

CREATE INDEX open_triggers_of_lots ON triggers (lot, n) WHERE state = 'open';
