"""The report of a lot: HTML, PDF, tables, and the curve that all of them show."""
