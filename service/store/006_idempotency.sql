-- Answers to requests that had an `Idempotency-Key`, for whoever repeats the request; removed after a day.
CREATE TABLE answers (
    who TEXT NOT NULL,
    key TEXT NOT NULL,
    request TEXT NOT NULL, -- digest of method, path, query and body
    answered_at TEXT NOT NULL,
    status INTEGER NOT NULL,
    headers TEXT NOT NULL CHECK (json_valid(headers)),
    body BLOB NOT NULL,
    PRIMARY KEY (who, key)
) STRICT;

CREATE INDEX answers_by_time ON answers (answered_at, who);

-- `GET /results?since=` finds its first result by it.
CREATE INDEX results_by_commit ON results (json_extract(record, '$.recorded_at'));
