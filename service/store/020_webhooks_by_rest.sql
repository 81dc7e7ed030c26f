-- Address, events and secrets of an endpoint that was made over REST, sealed with a key that lies beside the database and in
-- no backup; null for one of the configuration.
ALTER TABLE webhooks ADD COLUMN sealed TEXT;
