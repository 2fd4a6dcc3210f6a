"""Conversations that two captures hold."""

from __future__ import annotations

import pytest

from bcapscope.traffic.joining.frame_sample import FrameSample, find_shared
from tests.traffic.playbook import MOVE, MS, OTHER, Script


def sample(times: list[int], unshared: int = 0) -> FrameSample:
    """Return a sample of one conversation, with a request at each of these times in ns. Only samples with as
    many `unshared` requests have the last requests in common.
    """
    script = Script()
    client = script.client()
    made = FrameSample()
    for serial, time in enumerate(times, 1):
        move = MOVE if serial <= len(times) - unshared else OTHER
        made.add(client.ask(0, serial, 0, move)._replace(time=time))
    return made


@pytest.mark.parametrize(("deviation", "shared"), [(500 * MS, True), (500 * MS + 1, False)])
def test_a_frame_is_the_same_only_near_the_offset_of_the_others(deviation: int, shared: bool) -> None:
    times = [0, 8 * MS, 16 * MS, 24 * MS]
    later = [time + 60_000 * MS for time in times]
    later[-1] += deviation
    found = find_shared(sample(times), sample(later))
    assert [each.offset for each in found] == ([60_000 * MS] if shared else [])


@pytest.mark.parametrize(("others", "shared"), [(0, True), (4, True), (5, False)])
def test_at_least_half_of_the_equal_frames_must_have_one_offset(others: int, shared: bool) -> None:
    times = [number * 8 * MS for number in range(4 + others)]
    later = [time + 60_000 * MS for time in times]
    for number in range(others):
        later[number] += (number % 2 * 2 - 1) * (number + 2) * 1000 * MS
    found = find_shared(sample(times), sample(later))
    assert [each.offset for each in found] == ([60_000 * MS] if shared else [])


@pytest.mark.parametrize(
    ("frames", "shared", "is_sure"),
    [(40, 40, True), (39, 39, False), (100, 80, True), (100, 79, False)],
)
def test_captures_whose_times_do_not_overlap_must_share_most_of_many_frames(
    frames: int, shared: int, is_sure: bool
) -> None:
    times = [number * 8 * MS for number in range(frames)]
    later = [time + 60_000 * MS for time in times]
    (found,) = find_shared(sample(times), sample(later, unshared=frames - shared))
    assert found.is_sure is is_sure


def test_frames_that_occur_again_count_too() -> None:
    made, client = FrameSample(), Script().client()
    for ms in range(3):
        made.add(client.ask(ms, 1, 0, MOVE))
    assert made.count == 3
    assert [len(frames) for frames in made.frames.values()] == [1]
