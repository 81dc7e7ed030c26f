"""Alarms in the manner of ISA-18.2: what needs somebody, how urgently, and what to do."""
