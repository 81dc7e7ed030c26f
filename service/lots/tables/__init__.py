"""Tables that laboratories paste: their heads, their numbers, the sievings in them."""
