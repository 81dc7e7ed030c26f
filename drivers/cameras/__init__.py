"""GigE cameras through Aravis: found, configured, read back, their frames received."""
