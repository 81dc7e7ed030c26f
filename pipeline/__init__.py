"""Pure functions over arrays that turn the frames of one exposure into a measured stone.

Nothing in here reads a file, a clock or a device, logs, or starts a thread. The guide is `pipeline/README.md`.
"""
