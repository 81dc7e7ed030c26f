import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.gates.gate_protocol import (
    MAX_LINE_BYTES,
    LineSplitter,
    checksum,
    decode,
    encode,
    read_set_pulses,
    set_pulses,
)
from drivers.gates.gate_records import (
    SEQUENCES,
    CameraPulses,
    Edge,
    Identity,
    Record,
    Status,
    TestPulse,
    Width,
)

NUMBERS = st.integers(0, SEQUENCES - 1)
TIMES_US = st.integers(0, (1 << 64) - 1)
NAMES = st.from_regex(r"[A-Za-z0-9._+-]{1,32}", fullmatch=True)
RECORDS: st.SearchStrategy[Record] = st.one_of(
    st.builds(Edge, NUMBERS, TIMES_US),
    st.builds(TestPulse, NUMBERS, TIMES_US),
    st.builds(Width, NUMBERS, TIMES_US),
    st.builds(Status, device_us=TIMES_US, last_sequence=NUMBERS, ignored=NUMBERS, is_blocked=st.booleans()),
    st.builds(Identity, name=NAMES, serial=NAMES, version=NAMES),
    st.builds(CameraPulses, delay_us=NUMBERS, pulse_us=NUMBERS, places=NUMBERS, unmade=NUMBERS),
)


def test_the_checksum_is_crc_16_ccitt_false() -> None:
    assert checksum(b"123456789") == 0x29B1


@pytest.mark.parametrize(
    ("record", "line"),
    [
        (Edge(1, 2), b"$E,1,2*FC40\r\n"),
        (TestPulse(2, 3), b"$T,2,3*1B3A\r\n"),
        (Width(1, 3000), b"$W,1,3000*A93A\r\n"),
        (Status(device_us=9, last_sequence=2, ignored=0, is_blocked=True), b"$S,9,2,0,1*8F29\r\n"),
        (Identity(name="a", serial="b", version="1.0"), b"$I,a,b,1.0*1E34\r\n"),
        (
            CameraPulses(delay_us=247_350, pulse_us=100, places=8, unmade=0),
            b"$D,247350,100,8,0*5086\r\n",
        ),
    ],
)
def test_these_lines_are_the_protocol(record: Record, line: bytes) -> None:
    assert encode(record) == line
    assert decode(line) == record


def test_the_command_of_the_delay_is_signed() -> None:
    assert set_pulses(247_350, 100) == b"$D,247350,100*CFA5\n"
    assert read_set_pulses(b"$D,247350,100*CFA5") == (247_350, 100)
    for line in (
        b"$D,247350,101*CFA5",
        encode(CameraPulses(delay_us=1, pulse_us=1, places=8, unmade=0)),
        b"T",
    ):
        with pytest.raises(ValueError, match=r"."):
            read_set_pulses(line)


@given(RECORDS)
def test_decoding_is_the_inverse_of_encoding(record: Record) -> None:
    line = encode(record)
    assert len(line) <= MAX_LINE_BYTES
    assert decode(line) == decode(line[:-1]) == decode(line[:-2]) == record


@given(RECORDS, st.data())
def test_every_single_bit_error_is_found(record: Record, data: st.DataObject) -> None:
    line = bytearray(encode(record)[:-2])
    bit = data.draw(st.integers(0, 8 * len(line) - 1))
    line[bit // 8] ^= 1 << bit % 8
    with pytest.raises(ValueError, match=r"."):
        decode(bytes(line))


@given(st.binary(max_size=200))
def test_any_bytes_are_a_record_or_a_value_error(data: bytes) -> None:
    try:
        record = decode(data)
    except ValueError:
        return
    assert encode(record).startswith(data.rstrip(b"\r\n"))


def signed(body: bytes) -> bytes:
    return b"$%b*%04X\r\n" % (body, checksum(body))


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        (b"", "not of the form"),
        (b"$E,1,2\r\n", "not of the form"),
        (b"$E,1,2*fc40\r\n", "not of the form"),
        (b"$E,1,3*FC40\r\n", "checksum is FC40, should be"),
        (signed(b"E,1"), "unknown record"),
        (signed(b"X,1,2"), "unknown record"),
        (signed(b"E,01,2"), "not a number"),
        (signed(b"E,-1,2"), "not a number"),
        (signed(b"E, 1,2"), "not a number"),
        (signed(b"E,4294967296,2"), "not a number below 4294967296"),
        (signed("E,١,2".encode()), "not a number"),
        (signed(b"S,1,2,3,2"), "unknown record"),
        (signed(b"I,a b,c,d"), "not a name"),
    ],
)
def test_the_error_says_what_is_wrong(line: bytes, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        decode(line)


def test_what_has_no_place_in_a_line_is_not_sent() -> None:
    for record in (Edge(-1, 0), Edge(SEQUENCES, 0), Identity(name="a,b", serial="", version="*")):
        with pytest.raises(ValueError, match=r"."):
            encode(record)


@given(st.lists(RECORDS, max_size=6), st.lists(st.integers(1, 40), min_size=1))
def test_lines_come_out_whole_however_they_are_cut(records: list[Record], cuts: list[int]) -> None:
    splitter, rest = LineSplitter(), b"".join(map(encode, records))
    lines = []
    while rest:
        cut = cuts[len(lines) % len(cuts)]
        lines += splitter.feed(rest[:cut])
        rest = rest[cut:]
    assert [decode(line.text) for line in lines] == records
    assert splitter.n_discarded == 0


def test_half_a_line_costs_no_other() -> None:
    splitter = LineSplitter()
    lines = splitter.feed(b"3,99*FC" + encode(Edge(1, 2)) + b"$W,1" + encode(Edge(2, 3)))
    assert [decode(line.text) for line in lines] == [Edge(1, 2), Edge(2, 3)]
    assert splitter.n_discarded == 2


def test_a_line_knows_how_many_bytes_ago_it_began() -> None:
    splitter = LineSplitter()
    first, second = encode(Edge(1, 2)), encode(Edge(2, 3))
    splitter.feed(first[:4])
    lines = splitter.feed(first[4:] + second + b"$E,")
    assert [line.age_bytes for line in lines] == [len(first) + len(second) + 3, len(second) + 3]


@given(st.lists(st.binary(max_size=300).filter(lambda data: b"\n" not in data)))
def test_an_endless_line_is_not_kept(pieces: list[bytes]) -> None:
    splitter = LineSplitter()
    for piece in pieces:
        assert splitter.feed(piece) == []
    (rest, line) = splitter.feed(b"\n" + encode(Edge(1, 2)))
    assert len(rest.text) <= MAX_LINE_BYTES
    assert decode(line.text) == Edge(1, 2)
