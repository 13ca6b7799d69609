"""A camera's own numbers become those of frames: overflow, gaps, damaged frames, and losses by place."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.camera import CameraLost, CameraStatus
from acquisition.cameras.aravis.library import Underruns
from acquisition.frames.losses import LAST_SHORT_ID, BlockNumbers


def short() -> BlockNumbers:
    return BlockNumbers("camera", (LAST_SHORT_ID,))


def at_once(numbers: BlockNumbers, *blocks: int | None) -> list[int | None]:
    return [numbers.number(block, "dropped_by_bus") for block in blocks]


def test_numbers_go_on_where_short_ones_roll_over_and_long_ones_do_not() -> None:
    numbers, more = short(), BlockNumbers("camera", ())
    assert at_once(numbers, 65_534, 65_535, 1, 3) == [0, 1, 2, 4]
    assert at_once(more, 65_534, 65_535, 65_536, 65_538) == [0, 1, 2, 4]
    assert numbers.status(4) == more.status(4) == CameraStatus(4, dropped_by_bus=1)


def test_a_frame_that_comes_twice_is_given_once() -> None:
    numbers = short()
    assert at_once(numbers, 7, 7, 8) == [0, None, 1]
    assert numbers.status(2) == CameraStatus(2, wrong_id=1)


def test_a_frame_whose_number_is_not_known_follows_the_one_before() -> None:
    numbers = short()
    assert at_once(numbers, None, 5, None, 9, 10) == [0, 1, 2, 3, 4]
    assert numbers.status(5).dropped == 0


@pytest.mark.parametrize("counters", [(), (LAST_SHORT_ID,)])
def test_a_camera_that_counts_again_loses_nothing(counters: tuple[int, ...]) -> None:
    numbers = BlockNumbers("camera", counters)
    assert at_once(numbers, 500, 501, 1, 2) == [0, 1, 2, 3]
    assert numbers.status(4).dropped == 0


def test_one_whose_clock_begins_again_too_has_reset_itself() -> None:
    numbers = BlockNumbers("camera", (), has_clock=True)
    numbers.number(500, "dropped_by_camera", 10_000)
    assert numbers.number(499, "dropped_by_camera", 9_000) is None
    assert numbers.number(1, "dropped_by_camera", 1_000) is None
    assert numbers.number(2, "dropped_by_camera", 2_000) is None
    with pytest.raises(CameraLost, match="begun again, at 3 after 500"):
        numbers.number(3, "dropped_by_camera", 3_000)


def test_losses_are_told_apart() -> None:
    numbers = short()
    numbers.lost_parts += 1
    assert at_once(numbers, 2, 5) == [1, 4]  # the damaged one was the first
    numbers.lost_parts += 1
    assert at_once(numbers, 7) == [6]
    assert numbers.status(3) == CameraStatus(3, dropped_by_bus=2, incomplete=2)


def test_frames_of_which_parts_came_count_at_once_and_only_once() -> None:
    numbers = BlockNumbers("camera", (), has_clock=True)
    numbers.number(5, "dropped_by_camera", 1000)
    numbers.lost_parts, numbers.faulty = 3, 1
    assert numbers.status(1) == CameraStatus(1, incomplete=2, error_status=1)
    assert numbers.number(10, "dropped_by_camera", 6000) == 5
    assert numbers.status(2) == CameraStatus(2, dropped_by_camera=1, incomplete=2, error_status=1)


def test_frames_that_found_no_buffer_are_ours_although_the_count_is_seen_early() -> None:
    numbers, underruns = short(), Underruns()

    def number(block: int, arrived_ns: int, fetched_ns: int, count: int) -> int | None:
        was_full = underruns.occurred(arrived_ns, fetched_ns, count)
        return numbers.number(block, "dropped_by_host" if was_full else "dropped_by_bus")

    # (block, arrived, fetched, underruns): fetched at 20, then nothing until 600; two buffers hold 2 and 4,
    # the third frame and those from 5 to 59 found none
    seen = [(1, 10, 20, 0), (2, 20, 600, 900), (4, 40, 601, 900), (60, 600, 602, 900), (61, 610, 611, 900)]
    assert [number(*frame) for frame in seen] == [0, 1, 3, 59, 60]
    assert numbers.status(5) == CameraStatus(5, dropped_by_host=1 + 55)
    # later gaps are not: no buffer was missing in their time
    assert number(64, 640, 641, 900) == 63
    assert numbers.status(6) == CameraStatus(6, dropped_by_host=56, dropped_by_bus=2)


@given(
    st.integers(1, LAST_SHORT_ID),
    st.lists(st.sampled_from(["whole", "lost", "damaged"]), min_size=1, max_size=300),
)
def test_numbers_and_losses_always_agree(first: int, fates: list[str]) -> None:
    numbers, block = short(), first
    expected: list[int] = []
    found: list[int | None] = []
    for place, fate in enumerate(fates):
        if fate == "whole":
            found += at_once(numbers, block)
            expected.append(place)
        elif fate == "damaged":
            numbers.lost_parts += 1
        # zero is left out
        block = block % LAST_SHORT_ID + 1
    if not expected:
        return
    before = fates[: expected[0]].count("damaged")
    assert found == [place - expected[0] + before for place in expected]
    after = fates[expected[-1] :].count("damaged")
    lost = numbers.status(0).dropped
    assert lost - after == expected[-1] - expected[0] + before + 1 - len(expected)
