"""Bundles measured by the workers of a dask.distributed cluster, with the same results as on this machine."""
