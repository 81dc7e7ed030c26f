"""Calibrations from drops while measuring: collected, solved, activated; verifications with a ball."""
