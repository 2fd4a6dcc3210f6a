"""What a message on its way tells about its frames."""

from __future__ import annotations

from bcapscope.faults.wire_message import WireMessage
from bcapscope.traffic.call_kind import CallKind, RecentRequests
from bcapscope.traffic.observation import Flow
from tests.faults.traffic import ROBOT_EXECUTE, reply, request, talk


def kind_of(requests: RecentRequests, flow: Flow, data: bytes) -> CallKind | None:
    """Annotate a message, and return the kind of its call."""
    message = WireMessage(1, flow, data, 0, 0)
    message.annotate(requests)
    return message.call_kind


def test_the_kind_of_a_call_is_known_from_its_request_on() -> None:
    requests, flows = RecentRequests(), talk()
    slv_move = CallKind(ROBOT_EXECUTE, "slvMove")
    assert kind_of(requests, flows.up, b"no frame") is None
    assert kind_of(requests, flows.down, reply(5)) is None
    assert kind_of(requests, flows.up, request(5)) == slv_move
    assert kind_of(requests, flows.down, reply(5)) == slv_move


def test_a_frame_on_its_way_has_the_times_of_its_message_and_no_packet() -> None:
    (frame,) = WireMessage(7, talk().up, request(5), 0, 9).annotated_frames
    seen = frame.observation
    assert (seen.number, seen.time, seen.first_byte_time, seen.packet) == (7, 9, 9, 0)
