"""Messages and their signatures, by the words of standardwebhooks.com and of our own guide."""

import base64
import json
import re
from pathlib import Path
from typing import Any

import pytest
from support.webhook_receiver import KEY, OTHER_KEY, SECRET, is_signed, secret_of

from service.delivery.posting import MAX_BYTES, message_of, signatures, trial_message
from service.delivery.settings import key_of

GUIDE = Path(__file__).parents[4] / "service" / "web" / "README.md"
INSTANCE = "141fc8a1-0136-4f71-9b89-bda3f11805d3"


def event(**changes: Any) -> dict[str, Any]:
    given = {
        "seq": 7,
        "at": "2026-03-01T12:00:00.000Z",
        "type": "lot.closed",
        "subject": "L1",
        "data": {"n": 1},
    }
    return given | changes


def test_the_example_of_the_specification() -> None:
    """Id, time, body, secret and signature as the reference implementations of Standard Webhooks test them."""
    key = key_of("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw")
    signed = signatures([key], "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
    assert signed == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_two_secrets_sign_side_by_side() -> None:
    header = signatures([KEY, OTHER_KEY], "event-7", 1, b"{}")
    assert len(header.split(" ")) == 2
    headers = {"webhook-id": "event-7", "webhook-timestamp": "1", "webhook-signature": header}
    assert all(is_signed(headers, b"{}", key) for key in (KEY, OTHER_KEY))
    assert not is_signed(headers, b"{} ", KEY)


@pytest.mark.parametrize(
    "secret",
    ["", "abc", "whsec_", "whsec_***", secret_of(b"k" * 23), secret_of(b"k" * 65), SECRET + "\u00e9"],
)
def test_secrets_that_are_none_are_refused_without_telling_them(secret: str) -> None:
    with pytest.raises(ValueError, match="a secret") as raised:
        key_of(secret)
    assert len(secret) < 8 or secret not in str(raised.value)


def test_a_message_says_what_the_feed_says() -> None:
    message = message_of(event(), INSTANCE)
    assert json.loads(message.body) == {
        "type": "lot.closed",
        "timestamp": "2026-03-01T12:00:00.000Z",
        "data": {"instance_id": INSTANCE, "seq": 7, "subject": "L1", "details": {"n": 1}},
    }


def test_ids_tell_events_apart_and_outlive_a_restored_backup() -> None:
    message = message_of(event(), INSTANCE)
    assert re.fullmatch(r"event-7-[0-9a-f]{16}", message.id)
    assert message_of(event(), "another instance").id == message.id
    others = [
        event(seq=8),
        event(at="2026-03-01T12:00:00.001Z"),
        event(subject="L2"),
        event(type="lot.voided"),
    ]
    assert len({message_of(each, INSTANCE).id for each in (event(), *others)}) == 5
    assert trial_message(INSTANCE, "now").id != trial_message(INSTANCE, "now").id


def test_what_is_too_large_comes_without_its_details() -> None:
    large = message_of(event(data={"reasons": ["ü" * 10_000]}), INSTANCE)
    assert len(large.body) < 1000
    assert json.loads(large.body)["data"] == {
        "instance_id": INSTANCE,
        "seq": 7,
        "subject": "L1",
        "details": None,
    }
    nearly = message_of(event(data={"reasons": ["x" * 19_700]}), INSTANCE)
    assert 19_700 < len(nearly.body) < MAX_BYTES


def test_the_lines_of_the_guide_verify_a_message() -> None:
    (lines,) = re.findall(
        r"```python\n(import [^`]*def is_ours.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL
    )
    assert len(lines.splitlines()) <= 12
    known: dict[str, Any] = {}
    exec(lines, known)  # noqa: S102 - of our own guide
    body, now_s = b'{"type":"lot.closed"}', int(known["time"].time())

    def headers(timestamp_s: int, *keys: bytes) -> dict[str, str]:
        return {
            "webhook-id": "event-7",
            "webhook-timestamp": str(timestamp_s),
            "webhook-signature": signatures(keys, "event-7", timestamp_s, body),
        }

    assert base64.b64decode(SECRET.removeprefix("whsec_")) == KEY
    is_ours = known["is_ours"]
    assert is_ours(headers(now_s, KEY), body, SECRET)
    assert is_ours(headers(now_s, OTHER_KEY, KEY), body, SECRET)
    assert not is_ours(headers(now_s, OTHER_KEY), body, SECRET)
    assert not is_ours(headers(now_s, KEY), body + b" ", SECRET)
    assert not is_ours(headers(now_s - 3600, KEY), body, SECRET)
