"""Memory for frames that two processes share: a slot is taken again when nobody holds any view of its image."""

import gc
import os
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera_process.frame_memory import FilledSlots, SlotsToFill

SIZE_PX = (30, 20)
N_BYTES = 30 * 20


@pytest.fixture
def ends() -> Iterator[tuple[SlotsToFill, FilledSlots]]:
    yield connected(3)


def connected(n_slots: int) -> tuple[SlotsToFill, FilledSlots]:
    """Both ends, in one process."""
    here = SlotsToFill(n_slots)
    here.free(taken(here))
    with here.file:
        file = os.dup(here.file.fileno())
    return here, FilledSlots(file, here.slot_bytes, n_slots, here.free)


def taken(slots: SlotsToFill, grey: int = 0) -> int:
    """Receive a frame of one grey; return its slot."""
    pixels = slots.take(N_BYTES)
    assert pixels is not None
    pixels[:N_BYTES] = grey
    return slots.slot_of(pixels[:N_BYTES].reshape(SIZE_PX[::-1]))


def test_what_is_received_is_what_is_seen_read_only(ends: tuple[SlotsToFill, FilledSlots]) -> None:
    to_fill, filled = ends
    images = [filled.image(taken(to_fill, grey), SIZE_PX) for grey in (7, 8, 9)]
    assert [image.shape for image in images] == [(20, 30)] * 3
    assert [np.unique(image).tolist() for image in images] == [[7], [8], [9]]
    with pytest.raises(ValueError, match="read-only"):
        images[0][0, 0] = 1
    with pytest.raises(ValueError, match="cannot set WRITEABLE"):
        images[0].setflags(write=True)


def test_a_slot_is_free_with_the_last_view_of_its_image(ends: tuple[SlotsToFill, FilledSlots]) -> None:
    to_fill, filled = ends
    images = [filled.image(taken(to_fill), SIZE_PX) for _ in range(3)]
    assert to_fill.take(N_BYTES) is None
    assert filled.n_held == 3
    column = images.pop()[:, 4].T
    gc.collect()
    assert to_fill.take(N_BYTES) is None
    del column
    assert filled.n_held == 2
    assert to_fill.take(N_BYTES) is not None


def test_a_copy_holds_nothing(ends: tuple[SlotsToFill, FilledSlots]) -> None:
    to_fill, filled = ends
    copy = filled.copy(taken(to_fill, 5), SIZE_PX)
    assert filled.n_held == 0
    for _ in range(3):
        taken(to_fill, 6)
    assert np.unique(copy).tolist() == [5]


def test_images_outlive_both_ends() -> None:
    to_fill, filled = connected(1)
    image = filled.image(taken(to_fill, 3), SIZE_PX)
    del to_fill, filled
    gc.collect()
    assert np.unique(image).tolist() == [3]


@given(st.lists(st.integers(0, 5), max_size=60))
def test_no_image_is_ever_overwritten_while_it_is_held(choices: list[int]) -> None:
    to_fill, filled = connected(4)
    held: list[tuple[int, np.ndarray]] = []
    for step, choice in enumerate(choices):
        if choice < len(held):
            held.pop(choice)
        elif len(held) < 4:
            held.append((step, filled.image(taken(to_fill, step), SIZE_PX)))
        assert filled.n_held == len(held)
        assert all((image == grey).all() for grey, image in held)
