-- Watching the product: the figures that its control charts follow, as a lot was completed with them; the verdict that an
-- open lot has reached; and limits that the plant has set.
ALTER TABLE lots ADD COLUMN figures TEXT CHECK (figures IS NULL OR json_valid(figures));
ALTER TABLE lots ADD COLUMN reached TEXT CHECK (reached IS NULL OR json_valid(reached));

CREATE TABLE control_settings (
    product TEXT PRIMARY KEY,
    document TEXT NOT NULL CHECK (json_valid(document))
) STRICT;
