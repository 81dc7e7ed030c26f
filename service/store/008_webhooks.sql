-- How often what a lot says has changed since it was open: files of closed lots are written for each.
ALTER TABLE lots ADD COLUMN revision INTEGER NOT NULL DEFAULT 0;
UPDATE lots SET revision = 1 WHERE state <> 'open';

-- How far each webhook endpoint is with the events; and what came of the newest requests.
CREATE TABLE webhooks (
    name TEXT PRIMARY KEY,
    progress TEXT NOT NULL CHECK (json_valid(progress))
) STRICT;

CREATE TABLE webhook_deliveries (
    delivery INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    document TEXT NOT NULL CHECK (json_valid(document))
) STRICT;

CREATE INDEX deliveries_of_a_webhook ON webhook_deliveries (name, delivery);

-- Of each lot the revision whose files are written. The one row of `file_drop` says that earlier lots are not due.
CREATE TABLE file_drop (
    one INTEGER PRIMARY KEY CHECK (one = 1),
    began_at TEXT NOT NULL
) STRICT;

CREATE TABLE dropped_lots (
    lot TEXT PRIMARY KEY REFERENCES lots,
    revision INTEGER NOT NULL,
    at TEXT NOT NULL
) STRICT;
