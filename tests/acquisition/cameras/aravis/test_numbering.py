"""Frame ids are converted to numbers: overflow, gaps, damaged frames, and losses by cause."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.cameras.aravis.buffers import FrameNumbering


def at_once(numbering: FrameNumbering, *frame_ids: int) -> list[int | None]:
    """Numbers of frames that are fetched as they come, with buffers to spare."""
    return [numbering.number(frame_id, 0, 0, 0) for frame_id in frame_ids]


def next_id(frame_id: int) -> int:
    """The id after this one, as GigE Vision counts: zero is left out."""
    return frame_id % 65_535 + 1


def test_numbers_go_on_where_short_ids_roll_over() -> None:
    numbering = FrameNumbering(short_ids=True)
    assert at_once(numbering, 65_534, 65_535, 1, 2) == [0, 1, 2, 3]
    assert numbering.status.dropped == 0


def test_long_ids_do_not_roll_over() -> None:
    numbering = FrameNumbering(short_ids=False)
    assert at_once(numbering, 65_534, 65_535, 65_536, 65_538) == [0, 1, 2, 4]
    assert numbering.status.dropped_by_bus == 1


def test_a_frame_that_comes_twice_is_given_once() -> None:
    numbering = FrameNumbering(short_ids=True)
    assert at_once(numbering, 7, 7, 8) == [0, None, 1]


@pytest.mark.parametrize("short_ids", [True, False])
def test_a_camera_that_counts_again_loses_nothing(short_ids: bool) -> None:
    numbering = FrameNumbering(short_ids)
    assert at_once(numbering, 500, 501, 1, 2) == [0, 1, 2, 3]
    assert numbering.status.dropped == 0


def test_losses_are_told_apart() -> None:
    numbering = FrameNumbering(short_ids=True)
    numbering.damaged()
    assert at_once(numbering, 2, 5) == [1, 4]  # the damaged one was the first
    numbering.damaged()
    assert at_once(numbering, 7) == [6]
    status = numbering.status
    assert (status.incomplete, status.dropped_by_bus, status.dropped_by_host) == (2, 2, 0)
    assert status.delivered == 3


def test_frames_that_found_no_buffer_are_ours_although_the_count_is_seen_early() -> None:
    numbering = FrameNumbering(short_ids=True)
    # (id, arrived, fetched, underruns): fetched at 20, then nothing until 600; two buffers hold 2 and 4,
    # the third frame and those from 5 to 59 found none
    seen = [(1, 10, 20, 0), (2, 20, 600, 900), (4, 40, 601, 900), (60, 600, 602, 900), (61, 610, 611, 900)]
    assert [numbering.number(*frame) for frame in seen] == [0, 1, 3, 59, 60]
    assert (numbering.status.dropped_by_host, numbering.status.dropped_by_bus) == (1 + 55, 0)
    # later gaps are not: no buffer was missing in their time
    assert numbering.number(64, 640, 641, 900) == 63
    assert (numbering.status.dropped_by_host, numbering.status.dropped_by_bus) == (56, 2)


@given(
    st.integers(1, 65_535),
    st.lists(st.sampled_from(["whole", "lost", "damaged"]), min_size=1, max_size=300),
)
def test_numbers_and_losses_always_agree(first: int, fates: list[str]) -> None:
    numbering = FrameNumbering(short_ids=True)
    frame_id = first
    expected: list[int] = []
    numbers: list[int | None] = []
    for place, fate in enumerate(fates):
        if fate == "whole":
            numbers += at_once(numbering, frame_id)
            expected.append(place)
        elif fate == "damaged":
            numbering.damaged()
        frame_id = next_id(frame_id)
    if not expected:
        return
    before = fates[: expected[0]].count("damaged")
    assert numbers == [place - expected[0] + before for place in expected]
    assert numbering.status.delivered == len(expected)
    after = fates[expected[-1] :].count("damaged")
    assert numbering.status.dropped - after == expected[-1] - expected[0] + before + 1 - len(expected)
