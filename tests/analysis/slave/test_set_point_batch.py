"""Set points that wait: as they came, whatever their size."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.analysis.slave.set_point_batch import LARGE_FRAME, LATEST_TIME, FrameBytes, SetPointBatch
from bcapscope.analysis.slave.set_point_table import table_of
from bcapscope.protocol.codec.frame import Frame, encode_frame
from bcapscope.traffic.call import Call
from bcapscope.traffic.observation import (
    SERVER_PORT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Observation,
    Transport,
)
from bcapscope.traffic.tracker import Tracker
from tests.analysis.driving import Plan, joints

CONVERSATION = Conversation(Endpoint("10.0.0.2", 1), Endpoint("10.0.0.1", 5007), Transport.UDP, SERVER_PORT)


@given(
    st.lists(st.sampled_from([b"", b"a" * 20, b"b" * 20, b"c" * 21, b"d" * (LARGE_FRAME + 1)]), max_size=20)
)
def test_bodies_give_back_what_was_put_in(raws: list[bytes]) -> None:
    bodies = FrameBytes(raws)
    assert [bodies[place] for place in range(len(raws))] == raws
    assert len(bodies.data) == bodies.size * len(raws)
    assert bodies.size in (0, 20, 21)


def moves(count: int) -> list[Call]:
    plan = Plan()
    driver = plan.driver()
    for n in range(count):
        driver.move(8.0 * n + 8, joints(n), retries=(2.0,) if n % 5 == 4 else ())
    return [item for item in plan.track() if isinstance(item, Call)]


def test_kept_and_added_give_the_same_rows() -> None:
    calls = moves(20)
    fast, slow = SetPointBatch(), SetPointBatch()
    for call in calls:
        slow._add_irregular(call)
        fast.add(call)
    regular = len(calls) - len(fast.irregular)
    assert regular == 15, "the first tells the size, and every fifth was sent again"
    assert [fast[n] for n in range(20)] == [slow[n] for n in range(20)]
    ours, theirs = table_of(fast, fast[0].time), table_of(slow, slow[0].time)
    for name in ("calls", "times", "arrivals", "replies", "answered", "codes", "frames", "retries"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert fast.requests.data == slow.requests.data
    assert fast[-1] == slow[-1]


def test_columns_outlive_the_batch() -> None:
    batch = SetPointBatch()
    for call in moves(3):
        batch.add(call)
    rows = table_of(batch, 0)
    batch.clear()
    assert len(batch) == 0
    assert rows.calls == [1, 2, 3]


def test_times_that_no_clock_shows() -> None:
    tracker = Tracker()
    request = Frame(encode_frame(1, 1, 64, ()))
    for number, (time, way) in enumerate(((1 << 70, Direction.REQUEST), ((1 << 70) + 5, Direction.RESPONSE))):
        tracker.observe(Observation(number + 1, time, time, Flow(CONVERSATION, way), request, 1))
    (call,) = tracker.close()
    assert isinstance(call, Call)
    batch = SetPointBatch()
    batch.add(call)
    assert (batch[0].time, batch[0].reply_time) == (LATEST_TIME, LATEST_TIME)
    assert [place for place, _ in batch.irregular] == [0]
    batch.add(call)
    assert [place for place, _ in batch.irregular] == [0, 1]
    assert len(batch) == 2
    assert table_of(batch, -LATEST_TIME).times[0] == 2 * LATEST_TIME
