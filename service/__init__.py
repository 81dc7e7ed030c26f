"""The service: connects drivers and pipeline, stores the results, and serves them over REST and commands."""
