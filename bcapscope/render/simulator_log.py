"""The log that the simulator prints, with one line per call."""

from __future__ import annotations

from bcapscope.messages import ENGLISH_WORDS, MessageFormatter
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.render.escape import printable
from bcapscope.render.result_advice import result_text
from bcapscope.render.value_text import value_text
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.simulator import Peer
from bcapscope.traffic.observation import Endpoint

LONGEST_VALUE = 60  # characters of each argument


def call_log_line(peer: Peer, report: CallReport, words: MessageFormatter = ENGLISH_WORDS) -> str:
    parts = [_peer_text(peer), function_name(report.function_id)]
    parts += [_short_value_text(argument) for argument in report.arguments]
    parts += ["->", result_text(report.result.hresult, words=words)]
    if report.result.value is not None:
        parts.append(_short_value_text(report.result.value))
    took = (report.ended - report.began) / 1e6
    return " ".join([*parts, f"{took:.1f} ms"] if took else parts)


def refusal_line(peer: Peer, report: CallReport) -> str:
    return f"{_peer_text(peer)}: {printable(report.result.reason)}"


def _peer_text(peer: Peer) -> str:
    if not isinstance(peer, tuple):
        return str(peer)
    transport, (host, port, *_) = peer
    return f"{transport} {Endpoint(host, port)}"


def _short_value_text(variant: Variant) -> str:
    text = printable(_full_value_text(variant))
    return text if len(text) <= LONGEST_VALUE else text[: LONGEST_VALUE - 1] + "…"


def _full_value_text(variant: Variant) -> str:
    value = variant.value
    if value is None:
        return "-"
    if isinstance(value, bytes):
        return f"[{value[:LONGEST_VALUE].hex(' ')}]"
    if not isinstance(value, tuple):
        return value_text(value, variant.vt, LONGEST_VALUE)
    base = variant.vt & ~ARRAY
    shown = value[:LONGEST_VALUE]
    if base == VT.R8:
        # fast path, because every slvMove has two number arrays: format all elements in one step
        return repr([*shown])
    texts: list[str] = []
    room = LONGEST_VALUE
    for each in shown:
        if room < 0:
            break  # stop here: the line shows no more elements, and nested arrays can be large
        texts.append(
            _full_value_text(each) if isinstance(each, Variant) else value_text(each, base, LONGEST_VALUE)
        )
        room -= len(texts[-1])
    return f"[{', '.join(texts)}]"
