"""Stones of the store measured again from their archived frames, each as a revision of its result."""
