-- Each entry's digest covers its own content and the digest before it, see `service.store.audit`; NULL in entries of
-- earlier versions, which the first one after them covers all the same.
ALTER TABLE audit ADD COLUMN digest TEXT;
CREATE INDEX audit_by_subject ON audit (subject);
