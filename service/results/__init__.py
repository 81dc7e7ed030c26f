"""The result of a trigger: the one list of its fields, and the records made of them."""
