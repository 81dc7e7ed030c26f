"""What makes code hard to find one's way in is counted, and does not grow: `benchmarks/structure.py` prints it."""

from functools import cache

from benchmarks.structure import ROOT, Nodes, dark_lines, long_calls, mirrored_pairs, nodes_of, shared_names

MOST_MIRRORED = 5
"""Pairs of classes that share words, such as a lens and what was found of it, and are no copies of each other."""


@cache
def nodes() -> Nodes:
    return nodes_of(ROOT)


def test_no_class_is_a_copy_of_another() -> None:
    found = mirrored_pairs(nodes())
    assert len(found) <= MOST_MIRRORED, found


def test_no_two_public_classes_share_a_name() -> None:
    assert shared_names(nodes()) == []


def test_no_function_but_a_compiled_loop_takes_more_than_seven_parameters() -> None:
    assert long_calls(nodes()) == []


def test_first_lines_name_what_is_returned() -> None:
    assert dark_lines(nodes()) == []
