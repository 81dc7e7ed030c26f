"""`stonefall benchmark`: how true and how fast, beside the paper's method."""
