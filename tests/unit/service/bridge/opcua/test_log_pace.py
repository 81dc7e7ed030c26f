"""What the library logs is bounded; what the bridge logs is not."""

import logging

from service.bridge.opcua.log_pace import LINES, LibraryLogPace


def test_lines_of_the_library_are_bounded_and_no_others() -> None:
    pace = LibraryLogPace()
    of_library, ours = (
        logging.LogRecord(name, logging.ERROR, "", 0, "", None, None)
        for name in ("asyncua.server", "service")
    )
    assert [pace.filter(of_library) for _ in range(LINES + 5)] == [True] * LINES + [False] * 5
    assert pace.filter(ours)
