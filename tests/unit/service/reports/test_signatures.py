"""A signed report: not one byte of it can be changed unnoticed, and only a known key is relied on."""

import json
import stat
from functools import cache
from io import BytesIO
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st
from pypdf import PdfReader
from support.lot_figures import report_data

from service.base.errors import StoreError
from service.reports.printed import render_pdf
from service.reports.signatures import (
    KEY_FILE,
    MARK,
    InstrumentKey,
    SignatureState,
    checked,
    fingerprint_of,
    instrument_key,
    signed,
)

KEY, OTHER = (InstrumentKey(Ed25519PrivateKey.from_private_bytes(bytes([n] * 32))) for n in (1, 2))
LOT = {"instrument": "SF-16-0042 Süd", "lot": "L1", "revision": 2, "signed_at": "2026-11-20T07:00:03.000Z"}


@cache
def report() -> bytes:
    return render_pdf(report_data(signer=KEY.fingerprint))


@cache
def file() -> bytes:
    return signed(report(), KEY, **LOT)


def state_of(content: bytes) -> SignatureState:
    return checked(content, {KEY.fingerprint}).state


def test_a_signed_report_says_who_signed_what_and_when() -> None:
    found = checked(file(), {KEY.fingerprint})
    assert (found.state, found.fingerprint) == (SignatureState.GENUINE, KEY.fingerprint)
    assert found.statement is not None
    assert {name: getattr(found.statement, name) for name in LOT} == LOT
    assert "lot L1, revision 2" in found.detail


def test_only_a_known_key_is_relied_on() -> None:
    forged = signed(report(), OTHER, **LOT)
    for known in (set[str](), {KEY.fingerprint}):
        found = checked(forged, known)
        assert (found.state, found.fingerprint) == (SignatureState.UNKNOWN_KEY, OTHER.fingerprint)
    # a second signature over a signed file is the forger's
    assert state_of(signed(file(), OTHER, **LOT)) is SignatureState.UNKNOWN_KEY


@given(position=st.integers(0, len(file()) - 1), change=st.integers(1, 255))
def test_one_byte_changed_anywhere_is_refused(position: int, change: int) -> None:
    changed = bytearray(file())
    changed[position] ^= change
    assert state_of(bytes(changed)) in (SignatureState.CHANGED, SignatureState.NOT_SIGNED)


def test_each_bit_of_the_last_line_counts() -> None:
    content = file()
    for position in range(len(content) - 450, len(content)):
        for bit in range(8):
            changed = bytearray(content)
            changed[position] ^= 1 << bit
            assert state_of(bytes(changed)) is not SignatureState.GENUINE, position


@given(length=st.integers(0, len(file()) - 1))
def test_a_truncated_report_is_refused(length: int) -> None:
    assert state_of(file()[:length]) is not SignatureState.GENUINE


@given(more=st.binary(min_size=1, max_size=100))
def test_bytes_that_are_appended_or_put_before_are_refused(more: bytes) -> None:
    assert state_of(file() + more) is not SignatureState.GENUINE
    assert state_of(more + file()) is not SignatureState.GENUINE


@given(content=st.binary(max_size=2000))
def test_no_content_is_beyond_the_check(content: bytes) -> None:
    for each in (content, b"%PDF-" + content, report() + b"\n%stonefall-signature " + content):
        assert state_of(each) in (SignatureState.CHANGED, SignatureState.NOT_SIGNED)


def test_a_report_without_signature_is_told_from_a_changed_one() -> None:
    assert state_of(report()) is SignatureState.NOT_SIGNED
    assert state_of(b"no PDF") is SignatureState.NOT_SIGNED
    assert state_of(file().replace(b'"revision": 2', b'"revision": 3')) is SignatureState.CHANGED


def test_readers_of_pdf_open_a_signed_report_and_find_its_end() -> None:
    """Some look for `startxref` in the last 1024 bytes alone: the longest signature leaves it there."""
    longest = signed(report(), KEY, **LOT | {"instrument": "💎" * 64, "lot": "L" * 64, "revision": 2**63})
    assert b"startxref" in longest[-1024:]
    texts = [
        [page.extract_text() for page in PdfReader(BytesIO(each), strict=True).pages]
        for each in (report(), longest)
    ]
    assert texts[0] == texts[1]
    assert KEY.fingerprint in "".join(texts[0])


def test_what_a_later_version_signed_is_unchanged_though_it_cannot_be_read() -> None:
    """A report must never be called changed by an instrument that is only too old to read it."""
    text = json.dumps({"public_key": KEY.public_key, "of_a_later_version": True}).encode()
    content = b"%PDF-1.7\n%%EOF" + MARK + text
    later = content + b" " + KEY.private.sign(content).hex().encode() + b"\n"
    found = checked(later, {KEY.fingerprint})
    assert (found.state, found.fingerprint, found.statement) == (
        SignatureState.GENUINE,
        KEY.fingerprint,
        None,
    )
    assert "unchanged" in found.detail
    assert "later version" in found.detail
    assert checked(later, set()).state is SignatureState.UNKNOWN_KEY
    assert state_of(later.replace(b"1.7", b"1.6")) is SignatureState.CHANGED


@pytest.mark.parametrize("text", [b"{}", b'{"public_key": 7}', b'{"public_key": "zz"}', b"{" * 50_000 + b"}"])
def test_a_signature_without_a_key_proves_nothing(text: bytes) -> None:
    content = b"%PDF-1.7" + MARK + text + b" " + 128 * b"0" + b"\n"
    assert state_of(content) is SignatureState.CHANGED


def test_the_key_is_made_once_for_its_owner_alone(tmp_path: Path) -> None:
    first = instrument_key(tmp_path)
    assert stat.S_IMODE((tmp_path / KEY_FILE).stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == [KEY_FILE]
    assert instrument_key(tmp_path).public_key == first.public_key
    (tmp_path / "other").mkdir()
    assert instrument_key(tmp_path / "other").public_key != first.public_key


@pytest.mark.parametrize(
    "content", [b"", b"no key", b"-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n"]
)
def test_a_damaged_key_is_named_and_never_replaced(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / KEY_FILE
    path.write_bytes(content)
    with pytest.raises(StoreError, match=KEY_FILE):
        instrument_key(tmp_path)
    assert path.read_bytes() == content


def test_the_fingerprint_is_half_of_the_sha256() -> None:
    assert fingerprint_of("00" * 32) == "6668-7aad-f862-bd77-6c8f-c18b-8e9f-8e20"
