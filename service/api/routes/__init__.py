"""The resources of the REST interface, a module each: its schemas, and the functions that answer."""
