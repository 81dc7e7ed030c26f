"""A recording played in the place of devices: cameras and gate that share a belt."""
