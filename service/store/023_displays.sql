-- Keys of wall screens may only read, and sessions of theirs last as long as the key.
ALTER TABLE keys ADD COLUMN is_display INTEGER NOT NULL DEFAULT 0;
ALTER TABLE browser_sessions ADD COLUMN is_lasting INTEGER NOT NULL DEFAULT 0;

-- Screens that show a code to be signed in by; the secret of each is in the memory of the daemon alone.
CREATE TABLE pairings (
    code TEXT PRIMARY KEY CHECK (length(code) = 6),
    address TEXT NOT NULL,
    user_agent TEXT NOT NULL,
    opened_s INTEGER NOT NULL,
    key_sha256 TEXT
) STRICT;
