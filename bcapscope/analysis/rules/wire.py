"""What is wrong with the bytes, and with the capture itself."""

from __future__ import annotations

from collections.abc import Sequence

from bcapscope.analysis.client import Client, Clients
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.rule import SECOND, Incident, Report, Rule, Watcher
from bcapscope.analysis.speech import Speech, called
from bcapscope.protocol.arguments import Problem
from bcapscope.protocol.frame import LARGEST_UDP_FRAME, SOH, Frame, Malformed
from bcapscope.protocol.stream import STREAM_ENDS
from bcapscope.protocol.wording import counted
from bcapscope.traffic.exchange import Exchange, FrameObservation
from bcapscope.traffic.observation import Conversation, Direction, Flow, Observation, Transport

_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"

OVERSIZE = Rule(
    "oversize-datagram",
    Severity.ERROR,
    "a UDP frame is larger than the 503 bytes that b-CAP allows",
    "Use TCP, or send less in one call (shorter options, fewer elements): the official server drops such a "
    "datagram without an answer.",
    "orin_bcap C/include/dn_udp.h",
)
NEAR_LIMIT = Rule(
    "near-datagram-limit",
    Severity.NOTE,
    "a UDP request comes close to 503 bytes",
    "Expect 80000909 in the client when it grows: a larger packet is refused before it is sent and "
    "never seen here.",
    "orin_bcap C/include/dn_udp.h; DENSORobot/denso_robot_ros issue 9",
)
BAD_REQUEST = Rule(
    "malformed-request",
    Severity.ERROR,
    "a client sent bytes that are no sound frame",
    "Correct the client's encoder; a datagram that begins with 01 and has a wrong length, EOT or argument "
    "count stops the UDP service of the official server for all clients until it is restarted.",
    _SERVER,
)
BAD_REPLY = Rule(
    "malformed-reply",
    Severity.WARNING,
    "a server sent bytes that are no sound frame",
    "Expect 80010000 (E_INVALIDPACKET) or an exception in the client; check what stands between both.",
    "orin_bcap C/src/bCAPClient/bcap_client.c",
)
GAP = Rule(
    "capture-gap",
    Severity.NOTE,
    "the capture itself lacks bytes of a TCP stream",
    "Do not blame the robot for what is missing there: the capture lost packets, or began or ended in the "
    "middle. A larger buffer (tcpdump -B) or a filter (port 5007) helps.",
    "how a capture is made: the other end acknowledged these bytes, or they follow a hole",
)
CUT = Rule(
    "capture-cut",
    Severity.NOTE,
    "the capture kept only the beginning of a packet",
    "Capture again with a longer snap length (tcpdump -s 0).",
    "the original length of the packet in the capture file",
)
GUESSED = Rule(
    "server-guessed",
    Severity.NOTE,
    "which end is the server is only a guess",
    "Name the server's port with --port if the directions look wrong.",
    "nothing in a frame tells a request from a reply (orin_bcap C/include/bcap_common.h)",
)
DUPLICATE = Rule(
    "duplicate-frames",
    Severity.NOTE,
    "frames were seen twice, byte for byte",
    "If all are double, the capture saw each packet twice (two interfaces, a mirror port); otherwise the "
    "network copies packets.",
    "retries have a serial of their own in all known clients (orin_bcap C, C#, Java)",
)

_OVER_TCP = (
    "Correct the client's encoder; over TCP the official server skips what is before a 01, and ends the "
    "connection without a reply at a frame that it cannot read."
)
_ENDED = (
    "Look at what ended the connection just there, a crash or a time-out; only if the capture lacks its last "
    "packets may the frame have been whole."
)

LARGE = 480
"""Bytes of a frame from which on its size is looked at."""


_MOST_FLOWS = 4096
_AFTER_GAP = SECOND
_LONGEST_REASON = 160


class Wire(Watcher):
    """Looks at what does not decode as it should, and tells the capture's fault from the speaker's."""

    rules = (OVERSIZE, NEAR_LIMIT, BAD_REQUEST, BAD_REPLY, GAP, CUT, GUESSED, DUPLICATE)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._unsure: dict[Flow, int] = {}

    def fresh(self, seen: Observation) -> None:
        flow = seen.flow
        conversation = flow.conversation
        begun_unseen = conversation.transport is Transport.TCP and conversation.side_known_by != "the proxy"
        if begun_unseen and isinstance(seen.item, Malformed):
            self._doubt(flow, seen.time)  # the capture began in the middle of a frame
        if conversation.side_known_by.startswith("a guess") and flow.direction is Direction.REQUEST:
            text = f"that {flow.dst_text} is the server and {flow.src_text} the client is only a guess"
            self._see(GUESSED, seen, text)

    def odd(self, seen: Observation | FrameObservation) -> None:
        item = seen.item
        if isinstance(item, Frame):
            self._measure(seen, len(item.raw))
            problems = item.problems
            if not problems:
                return
        else:
            problems = item.problems
        if isinstance(item, Malformed) and item.missing:
            self._doubt(seen.flow, seen.time)
            self._see(
                GAP,
                seen,
                f"the capture lacks {counted(item.missing, 'byte')} of what {seen.flow.src_text} sent",
            )
        elif seen.flow.conversation.transport is Transport.TCP and self._is_torn(seen, problems):
            who = seen.flow.src_text
            if _is_last_of_connection(seen, problems):
                text = f"the connection ended in the middle of frame {seen.number} from {who}"
                self._see(GAP, seen, text, _ENDED)
            else:
                self._see(GAP, seen, f"the capture has only a part of what {who} sent here")
        elif any(problem.code == "cut" for problem in problems):
            self._see(
                CUT,
                seen,
                f"frame {seen.number} is cut: {_reasons([each for each in problems if each.code == 'cut'])}",
            )
        else:
            self._malformed(seen, problems)

    def call(self, call: Exchange, client: Client) -> None:
        copies = call.duplicates
        if copies:
            self.tell(
                DUPLICATE,
                call,
                lambda speech: (
                    f"a copy of a frame of {called(call)} was seen ({counted(len(copies), 'copy', 'copies')})"
                ),
            )

    def forget(self, conversation: Conversation) -> None:
        for flow in [flow for flow in self._unsure if flow.conversation is conversation]:
            del self._unsure[flow]

    def _doubt(self, flow: Flow, time: int) -> None:
        if len(self._unsure) >= _MOST_FLOWS:
            self._unsure.clear()
        self._unsure[flow] = time

    def _is_torn(self, seen: Observation | FrameObservation, problems: tuple[Problem, ...]) -> bool:
        """Tell whether bytes of a stream are odd since the capture lacks what is before or behind them."""
        since = seen.time - self._unsure.pop(seen.flow, -_AFTER_GAP)
        return any(problem.code == "cut" for problem in problems) or (
            isinstance(seen.item, Malformed) and since < _AFTER_GAP
        )

    def _measure(self, seen: Observation | FrameObservation, size: int) -> None:
        if seen.flow.conversation.transport is not Transport.UDP or size < LARGE:
            return
        who = seen.flow.src_text
        if size > LARGEST_UDP_FRAME:
            self._see(
                OVERSIZE,
                seen,
                f"a UDP frame of {size} bytes from {who}, where b-CAP allows {LARGEST_UDP_FRAME}",
            )
        elif seen.flow.direction is Direction.REQUEST:
            self._see(
                NEAR_LIMIT,
                seen,
                f"a UDP request of {size} bytes, and {LARGEST_UDP_FRAME} is the most that is sent at all",
            )

    def _malformed(self, seen: Observation | FrameObservation, problems: tuple[Problem, ...]) -> None:
        reasons = _reasons(problems)
        if seen.flow.direction is Direction.RESPONSE:
            self._see(
                BAD_REPLY, seen, f"frame {seen.number} from {seen.flow.src_text} is malformed: {reasons}"
            )
            return
        transport = seen.flow.conversation.transport
        udp = transport is Transport.UDP
        deadly = udp and seen.item.raw[:1] == bytes((SOH,))
        danger = "; such a datagram can stop the official server" if deadly else ""
        self._see(
            BAD_REQUEST,
            seen,
            f"frame {seen.number} from {seen.flow.src_text} is malformed: {reasons}{danger}",
            "" if transport is not Transport.TCP else _OVER_TCP,
            transport,
        )

    def _see(
        self, rule: Rule, seen: Observation | FrameObservation, text: str, advice: str = "", key: str = ""
    ) -> None:
        def say(speech: Speech) -> str:
            return f"{text}, at {speech.at(seen.time)}"

        frames = (seen.number,)
        conversation = seen.flow.conversation
        self.report(Incident(rule, seen.began, seen.time, conversation, frames, say, key=key, advice=advice))


def _is_last_of_connection(seen: Observation | FrameObservation, problems: Sequence[Problem]) -> bool:
    """Tell whether the end of a connection that was seen to end cuts a frame."""
    ended = seen.flow.conversation.closing is not None
    return ended and any(problem.reason == STREAM_ENDS for problem in problems)


def _reasons(problems: Sequence[Problem]) -> str:
    text = "; ".join(problem.reason for problem in problems)
    return text if len(text) <= _LONGEST_REASON else text[:_LONGEST_REASON] + "…"
