"""Alarms in the manner of ISA-18.2: conditions that need an operator, with their urgency and remedy."""
