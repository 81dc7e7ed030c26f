import pytest

from pipeline.formats import unread_format


@pytest.mark.parametrize(
    ("found", "is_later"),
    [
        ("stonefall-rig/2", True),
        ("stonefall-rig/12", True),
        ("stonefall-rig/0", False),
        ("stonefall-rig/01", False),
        ("stonefall-rig/2.1", False),
        ("stonefall-mesh/2", False),
        ("", False),
        (None, False),
        (2, False),
        ([], False),
    ],
)
def test_a_later_version_is_told_from_another_kind(found: object, is_later: bool) -> None:
    said = unread_format(found, "stonefall-rig/1")
    assert said == (
        f'is "{found}", of a later version: update stonefall, which reads up to "stonefall-rig/1"'
        if is_later
        else f'must be "stonefall-rig/1", not {found!r}'
    )
