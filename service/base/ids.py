"""Ids of lots, products and consumers: safe in URLs, names of files and lines of shells."""

ID = r"^(?:[A-Za-z0-9_.-]{3,64}|[A-Za-z0-9_.-]?[A-Za-z0-9_-]|[A-Za-z0-9_-]\.)$"
"""Pattern of an id that is asked for: 1 to 64 characters, neither `.` nor `..`, which clients take out of addresses."""
NEW_ID = r"^[A-Za-z0-9_](?:[A-Za-z0-9_.-]{0,62}[A-Za-z0-9_-])?$"
"""Pattern of an id that is given: no folder such as `..`, no option such as `-f`, no dot that Windows drops."""
ID_WORDS = (
    "must be 1 to 64 letters of A to Z, digits, _ . or -, and begin and end with none of . and -;"
    " other numbers of the plant belong into external_id, order or remark"
)
"""What both ask for, in words."""
