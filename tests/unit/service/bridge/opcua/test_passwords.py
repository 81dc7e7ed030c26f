"""Passwords of OPC UA users: only a salted hash is kept."""

import pytest

from service.bridge.opcua.passwords import hash_password, is_password
from service.bridge.opcua.settings import OpcUaSettings, OpcUaUser


def test_a_hash_knows_its_password_and_no_other() -> None:
    stored = hash_password("straße 7")
    assert is_password("straße 7", stored)
    assert not is_password("straße 8", stored)
    assert not is_password("", stored)
    assert not is_password("x" * 2000, stored)
    assert "straße" not in stored


def test_two_users_with_one_password_have_different_hashes() -> None:
    assert hash_password("a") != hash_password("a")


@pytest.mark.parametrize("stored", ["right", "scrypt:16384:8:1:short:hash", ""])
def test_a_password_in_plain_text_is_refused_by_name(stored: str) -> None:
    with pytest.raises(ValueError, match="user anna: password must be what"):
        OpcUaUser(name="anna", password=stored)
    assert not is_password(stored, stored)


def test_users_have_one_proof_and_one_name() -> None:
    with pytest.raises(ValueError, match="either a password or a certificate"):
        OpcUaUser(name="anna")
    anna = OpcUaUser(name="anna", password=hash_password("a"))
    with pytest.raises(ValueError, match="different names"):
        OpcUaSettings(users=(anna, anna))
    with pytest.raises(ValueError, match="port must be"):
        OpcUaSettings(port=70_000)
    with pytest.raises(ValueError, match="host must be"):
        OpcUaSettings(host="a b")
