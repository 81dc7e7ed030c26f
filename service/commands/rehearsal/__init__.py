"""Rehearse days of a plant for the writer of a client: a small simulated rig, a daemon of its own, faults."""
