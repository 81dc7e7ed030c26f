-- What happened beside results, numbered without a gap; the newest 100 000 are kept, and up to 1000 more.
ALTER TABLE store ADD COLUMN last_event INTEGER NOT NULL DEFAULT 0;

CREATE TABLE events (
    seq INTEGER PRIMARY KEY,
    at TEXT NOT NULL,
    type TEXT NOT NULL,
    subject TEXT NOT NULL,
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;

CREATE TRIGGER bound_events AFTER INSERT ON events WHEN NEW.seq % 1000 = 0 BEGIN
    DELETE FROM events WHERE seq <= (SELECT seq FROM events ORDER BY seq DESC LIMIT 1 OFFSET 100000);
END;

-- One row for each alarm, from its first rise to its end; at most one of a check has not ended.
CREATE TABLE alarms (
    alarm INTEGER PRIMARY KEY,
    subject TEXT NOT NULL,
    state TEXT NOT NULL,
    ended_at TEXT,
    document TEXT NOT NULL CHECK (json_valid(document))
) STRICT;

CREATE UNIQUE INDEX one_alarm_of_a_check ON alarms (subject) WHERE ended_at IS NULL;

CREATE TRIGGER bound_alarms AFTER INSERT ON alarms WHEN NEW.alarm % 1000 = 0 BEGIN
    DELETE FROM alarms WHERE ended_at IS NOT NULL AND alarm <= NEW.alarm - 100000;
END;
