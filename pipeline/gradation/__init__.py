"""Many stones to a gradation, its uncertainty and a verdict."""
