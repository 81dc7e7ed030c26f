"""From the spool to durable results: the worker pool that measures bundles. Begin at `processing`."""
