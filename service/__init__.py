"""The daemon: wires drivers and pipeline, keeps the results, serves them."""
