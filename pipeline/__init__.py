"""From sixteen frames to the measured stone: pure functions over arrays.

Nothing in here reads a file, a clock or a device, logs, or starts a thread.
"""
