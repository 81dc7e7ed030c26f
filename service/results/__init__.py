"""What is said of each trigger: one list of fields, and the records that are made of it."""
