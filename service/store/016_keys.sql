-- Keys that `stonefall keys` makes, each with its scopes side by side; a revoked one stays.
CREATE TABLE keys (
    sha256 TEXT PRIMARY KEY CHECK (length(sha256) = 64 AND sha256 NOT GLOB '*[^0-9a-f]*'),
    name TEXT NOT NULL,
    scopes TEXT NOT NULL,
    created_at TEXT NOT NULL,
    created_by TEXT NOT NULL,
    expires_at TEXT,
    revoked_at TEXT,
    revoked_by TEXT
) STRICT;

-- 0: all keys that were ever made are here; only then a store without any is open. A new one has 1 until it is known
-- that there was none before.
ALTER TABLE store ADD COLUMN keys_lost INTEGER NOT NULL DEFAULT 1;
UPDATE store SET keys_lost = 0;

-- Sessions of browsers that signed in with a key; times are seconds since 1970.
CREATE TABLE browser_sessions (
    cookie_sha256 TEXT PRIMARY KEY,
    key_sha256 TEXT NOT NULL,
    begun_s INTEGER NOT NULL,
    renewed_s INTEGER NOT NULL
) STRICT;
