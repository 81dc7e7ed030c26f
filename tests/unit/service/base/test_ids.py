"""Ids of lots, products, consumers and webhooks: each is one segment of an address that no client takes out."""

import re
from itertools import product

from service.base.ids import ID, NEW_ID


def test_every_id_but_the_dots_of_folders_is_asked_for() -> None:
    for length in range(5):
        for letters in product("a-./", repeat=length):
            text = "".join(letters)
            is_id = text != "" and "/" not in text and text not in (".", "..")
            assert (re.search(ID, text) is not None) == is_id, text
    assert re.search(ID, 64 * "a") and not re.search(ID, 65 * "a")


def test_what_is_given_may_be_asked_for() -> None:
    for letters in product("a-.", repeat=4):
        text = "".join(letters)
        assert re.search(ID, text) or not re.search(NEW_ID, text)
