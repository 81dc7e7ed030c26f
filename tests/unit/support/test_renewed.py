from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from support.renewed import HAS_FAILED, Renewed


def test_only_the_test_after_a_failure_gets_a_new_one(request: pytest.FixtureRequest) -> None:
    made, ended = [], []

    @contextmanager
    def make() -> Iterator[int]:
        made.append(len(made) + 1)
        yield made[-1]
        ended.append(made[-1])

    test = request.node
    with Renewed(make) as things:
        with things.lent_to(test) as first, things.lent_to(test) as second:
            assert (first, second) == (1, 1)
        test.stash[HAS_FAILED] = True
        with things.lent_to(test):
            assert ended == []
        assert ended == [1]
        del test.stash[HAS_FAILED]
        with pytest.raises(AssertionError), things.lent_to(test) as third:
            assert third == 0, "a check of the fixture"
        assert ended == [1, 2]
        with things.lent_to(test) as fourth:
            assert fourth == 3
    assert made == ended == [1, 2, 3]
