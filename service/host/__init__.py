"""The machine that the daemon runs on: what it needs of it, and what is found there."""
