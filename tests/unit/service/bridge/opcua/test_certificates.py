"""The server's own certificate, and the folder of trusted ones."""

from datetime import timedelta
from pathlib import Path

import pytest
from asyncua.crypto.cert_gen import generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding
from support.opcua import make_identity

from service.bridge.opcua import certificates
from service.bridge.opcua.certificates import (
    CertificateFileError,
    is_trusted,
    keep_rejected,
    load_certificate,
    now_utc,
    own_certificate,
    trouble_of,
    uris_of,
)

URI = "urn:tests:server"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose server has a certificate."""
    made = tmp_path_factory.mktemp("certificates")
    own_certificate(made, URI, "localhost", now_utc())
    return made


def test_key_and_certificate_are_made_once_for_their_owner_alone(folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.glob("server*")}
    own = own_certificate(folder, URI, "localhost", now_utc())
    assert {path: path.read_bytes() for path in folder.glob("server*")} == before
    assert {path.name: oct(path.stat().st_mode & 0o777) for path in before} == {
        "server.der": "0o600",
        "server.key.pem": "0o600",
    }
    assert uris_of(own.certificate) == [URI]
    assert own.certificate.public_key() == own.key.public_key()
    assert trouble_of(own.certificate, now_utc()) is None


def test_it_is_made_anew_with_the_same_key_before_its_end_and_under_another_uri(tmp_path: Path) -> None:
    first = own_certificate(tmp_path, URI, "localhost", now_utc())
    just_before = first.renewal_at - timedelta(seconds=1)
    assert own_certificate(tmp_path, URI, "localhost", just_before).certificate == first.certificate
    second = own_certificate(tmp_path, URI, "localhost", first.renewal_at)
    assert second.certificate != first.certificate
    assert second.key.public_key() == first.key.public_key()
    assert uris_of(own_certificate(tmp_path, "urn:other", "localhost", now_utc()).certificate) == [
        "urn:other"
    ]


@pytest.mark.parametrize("name", ["server.key.pem", "server.der"])
def test_a_damaged_file_is_named_and_not_replaced(folder: Path, tmp_path: Path, name: str) -> None:
    for path in folder.glob("server*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / name).write_bytes(b"-----BEGIN nothing")
    with pytest.raises(CertificateFileError, match=name):
        own_certificate(tmp_path, URI, "localhost", now_utc())
    assert (tmp_path / name).read_bytes() == b"-----BEGIN nothing"


def test_trusted_is_the_very_certificate_as_der_or_pem(folder: Path) -> None:
    identity = make_identity(folder, "one")
    assert not is_trusted(folder, identity.der)
    trusted = folder / "trusted" / "one.pem"
    trusted.write_bytes(load_certificate(identity.certificate).public_bytes(Encoding.PEM))
    (folder / "trusted" / "a-note.txt").write_text("who has which")
    assert is_trusted(folder, identity.der)
    trusted.unlink()
    assert not is_trusted(folder, identity.der)


def test_an_expired_certificate_has_trouble(folder: Path) -> None:
    certificate = load_certificate(make_identity(folder, "old", days=1).certificate)
    assert trouble_of(certificate, now_utc()) is None
    assert "valid from" in str(trouble_of(certificate, now_utc() + timedelta(days=2)))
    assert "valid from" in str(trouble_of(certificate, now_utc() - timedelta(days=2)))


def test_rejected_certificates_are_bounded_in_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "MAX_REJECTED", 3)
    (tmp_path / "rejected").mkdir()
    for number in range(6):
        kept = keep_rejected(tmp_path, bytes([number]) * 900)
        assert kept.read_bytes() == bytes([number]) * 900
    assert len(list((tmp_path / "rejected").iterdir())) == 3
    assert keep_rejected(tmp_path, bytes(20_000)).exists() is False


def test_generated_keys_are_those_that_the_policy_allows() -> None:
    assert generate_private_key().key_size in certificates.RSA_BITS
