"""Rules about damaged bytes, and about the capture itself."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.analysis.client_state import ClientRegistry, ClientState
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule_checker import (
    SECOND,
    DiagnosisRule,
    Occurrence,
    OccurrenceSink,
    RuleChecker,
)
from bcapscope.analysis.speech import Speech, called
from bcapscope.protocol.codec.arguments import Problem
from bcapscope.protocol.codec.frame import LARGEST_UDP_FRAME, SOH, Frame, Malformed
from bcapscope.protocol.codec.stream_splitter import STREAM_ENDED
from bcapscope.protocol.text_format import counted
from bcapscope.traffic.call import Call, FrameObservation
from bcapscope.traffic.observation import Conversation, Direction, Flow, Observation, Transport

_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"

OVERSIZE_DATAGRAM = DiagnosisRule(
    "oversize-datagram",
    Severity.ERROR,
    "orin_bcap C/include/dn_udp.h",
)
NEAR_DATAGRAM_LIMIT = DiagnosisRule(
    "near-datagram-limit",
    Severity.NOTE,
    "orin_bcap C/include/dn_udp.h; DENSORobot/denso_robot_ros issue 9",
)
MALFORMED_REQUEST = DiagnosisRule(
    "malformed-request",
    Severity.ERROR,
    _SERVER,
)
MALFORMED_REPLY = DiagnosisRule(
    "malformed-reply",
    Severity.WARNING,
    "orin_bcap C/src/bCAPClient/bcap_client.c",
)
CAPTURE_GAP = DiagnosisRule(
    "capture-gap",
    Severity.NOTE,
    "how a capture is made: the other end acknowledged these bytes, or they follow a hole",
)
CAPTURE_CUT = DiagnosisRule(
    "capture-cut",
    Severity.NOTE,
    "the original length of the packet in the capture file",
)
SERVER_GUESSED = DiagnosisRule(
    "server-guessed",
    Severity.NOTE,
    "nothing in a frame tells a request from a reply (orin_bcap C/include/bcap_common.h)",
)
DUPLICATE_FRAMES = DiagnosisRule(
    "duplicate-frames",
    Severity.NOTE,
    "retries have a serial of their own in all known clients (orin_bcap C, C#, Java)",
)

_TCP_ADVICE = (
    "Correct the client's encoder; over TCP the official server skips what is before a 01, and ends the "
    "connection without a reply at a frame that it cannot read."
)
_ENDED_ADVICE = (
    "Look at what ended the connection just there, a crash or a time-out; only if the capture lacks its last "
    "packets may the frame have been whole."
)

CHECKED_FROM_BYTES = 480
"""Frame size in bytes from which the size is checked."""


_MAX_FLOWS = 4096
_RESYNC_WITHIN_NS = SECOND
_LONGEST_REASON = 160


class WireChecker(RuleChecker):
    """Checks damaged frames; separates faults of the capture from faults of the sender."""

    rules = (
        OVERSIZE_DATAGRAM,
        NEAR_DATAGRAM_LIMIT,
        MALFORMED_REQUEST,
        MALFORMED_REPLY,
        CAPTURE_GAP,
        CAPTURE_CUT,
        SERVER_GUESSED,
        DUPLICATE_FRAMES,
    )

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        super().__init__(report_occurrence, clients)
        self._resync_since: dict[Flow, int] = {}

    def on_new_flow(self, observation: Observation) -> None:
        flow = observation.flow
        conversation = flow.conversation
        begun_unseen = conversation.transport is Transport.TCP and conversation.server_known_by != "the proxy"
        if begun_unseen and isinstance(observation.item, Malformed):
            self._expect_resync(flow, observation.time)  # the capture began in the middle of a frame
        if conversation.server_known_by.startswith("a guess") and flow.direction is Direction.REQUEST:
            text = f"that {flow.dst_text} is the server and {flow.src_text} the client is only a guess"
            self._report_frame(SERVER_GUESSED, observation, text)

    def on_suspect_frame(self, observation: Observation | FrameObservation) -> None:
        item = observation.item
        if isinstance(item, Frame):
            self._check_size(observation, len(item.raw))
            problems = item.problems
            if not problems:
                return
        else:
            problems = item.problems
        if isinstance(item, Malformed) and item.missing:
            self._expect_resync(observation.flow, observation.time)
            self._report_frame(
                CAPTURE_GAP,
                observation,
                f"the capture lacks {counted(item.missing, 'byte')} of what {observation.flow.src_text} sent",
            )
        elif observation.flow.conversation.transport is Transport.TCP and self._is_incomplete(
            observation, problems
        ):
            who = observation.flow.src_text
            if _is_cut_by_closing(observation, problems):
                text = f"the connection ended in the middle of frame {observation.number} from {who}"
                self._report_frame(CAPTURE_GAP, observation, text, _ENDED_ADVICE)
            else:
                self._report_frame(
                    CAPTURE_GAP, observation, f"the capture has only a part of what {who} sent here"
                )
        elif cuts := [problem for problem in problems if problem.code == "cut"]:
            self._report_frame(
                CAPTURE_CUT,
                observation,
                f"frame {observation.number} is cut: {_problem_reasons(cuts)}",
            )
        else:
            self._report_malformed(observation, problems)

    def on_call(self, call: Call, client: ClientState) -> None:
        copies = call.duplicates
        if copies:
            self.report_call(
                DUPLICATE_FRAMES,
                call,
                lambda speech: (
                    f"a copy of a frame of {called(call)} was seen ({counted(len(copies), 'copy', 'copies')})"
                ),
            )

    def on_conversation_closed(self, conversation: Conversation) -> None:
        for flow in [flow for flow in self._resync_since if flow.conversation is conversation]:
            del self._resync_since[flow]

    def _expect_resync(self, flow: Flow, time: int) -> None:
        if len(self._resync_since) >= _MAX_FLOWS:
            self._resync_since.clear()
        self._resync_since[flow] = time

    def _is_incomplete(
        self, observation: Observation | FrameObservation, problems: tuple[Problem, ...]
    ) -> bool:
        """Return whether stream bytes look damaged only because the capture lacks their neighbours."""
        since = observation.time - self._resync_since.pop(observation.flow, -_RESYNC_WITHIN_NS)
        return any(problem.code == "cut" for problem in problems) or (
            isinstance(observation.item, Malformed) and since < _RESYNC_WITHIN_NS
        )

    def _check_size(self, observation: Observation | FrameObservation, size: int) -> None:
        if observation.flow.conversation.transport is not Transport.UDP or size < CHECKED_FROM_BYTES:
            return
        who = observation.flow.src_text
        if size > LARGEST_UDP_FRAME:
            self._report_frame(
                OVERSIZE_DATAGRAM,
                observation,
                f"a UDP frame of {size} bytes from {who}, where b-CAP allows {LARGEST_UDP_FRAME}",
            )
        elif observation.flow.direction is Direction.REQUEST:
            self._report_frame(
                NEAR_DATAGRAM_LIMIT,
                observation,
                f"a UDP request of {size} bytes, and {LARGEST_UDP_FRAME} is the most that is sent at all",
            )

    def _report_malformed(
        self, observation: Observation | FrameObservation, problems: tuple[Problem, ...]
    ) -> None:
        reasons = _problem_reasons(problems)
        if observation.flow.direction is Direction.RESPONSE:
            self._report_frame(
                MALFORMED_REPLY,
                observation,
                f"frame {observation.number} from {observation.flow.src_text} is malformed: {reasons}",
            )
            return
        transport = observation.flow.conversation.transport
        udp = transport is Transport.UDP
        deadly = udp and observation.item.raw[:1] == bytes((SOH,))
        danger = "; such a datagram can stop the official server" if deadly else ""
        self._report_frame(
            MALFORMED_REQUEST,
            observation,
            f"frame {observation.number} from {observation.flow.src_text} is malformed: {reasons}{danger}",
            "" if transport is not Transport.TCP else _TCP_ADVICE,
            transport,
        )

    def _report_frame(
        self,
        rule: DiagnosisRule,
        observation: Observation | FrameObservation,
        text: str,
        advice: str = "",
        key: str = "",
    ) -> None:
        def say(speech: Speech) -> str:
            return f"{text}, at {speech.at(observation.time)}"

        frames = (observation.number,)
        conversation = observation.flow.conversation
        self.report_occurrence(
            Occurrence(
                rule,
                observation.first_byte_time,
                observation.time,
                conversation,
                frames,
                say,
                group_key=key,
                advice=advice,
            )
        )


def _is_cut_by_closing(observation: Observation | FrameObservation, problems: Sequence[Problem]) -> bool:
    """Return whether the captured end of a connection cuts a frame."""
    ended = observation.flow.conversation.connection_end is not None
    return ended and any(problem.reason == STREAM_ENDED for problem in problems)


def _problem_reasons(problems: Sequence[Problem]) -> str:
    text = "; ".join(str(problem.reason) for problem in problems)
    return text if len(text) <= _LONGEST_REASON else text[:_LONGEST_REASON] + "…"
