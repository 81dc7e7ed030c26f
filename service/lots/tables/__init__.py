"""Tables that laboratories paste: the words of their heads, the sievings in them."""
