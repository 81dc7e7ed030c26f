"""REST: problems, keys, streams, the OpenAPI document. Begin at `app`; `routes/` has a module each resource."""
