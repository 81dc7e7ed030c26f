"""Tables that people send, whatever wrote them: text of any encoding and mark, or a workbook; one reader for all."""
