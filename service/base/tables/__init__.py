"""Tables of any spreadsheet: text of any encoding and delimiter, or a workbook; one reader for all."""
