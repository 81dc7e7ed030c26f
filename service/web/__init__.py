"""HTTP for all rooms: server and its limits, keys and sessions, problems, idempotency, ETags, feeds, streams, pages."""
