"""The active errors of a controller, also of one that lacks the commands for them."""

from __future__ import annotations

import pytest

from bcapscope.client import Controller, open_session
from bcapscope.client.controller_errors import MAX_ERRORS, clear_errors, read_errors
from bcapscope.errors import CallTimeout
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.hresult import E_INVALIDARG, S_OK, describe_hresult
from tests.client.peer import Answer, Peer
from tests.memory_link import memory_link_pair, over_link
from tests.virtual_time import run_in_virtual_time

SINGULAR = -0x7BDEFEDF  # 0x84210121 as a signed number


class _ErrorPeer(Peer):
    """A peer that answers GetCurErrorCount with `count` and GetCurErrorInfo with `info`."""

    count = 1
    info: tuple[Variant, ...] = ()

    def _execute(self, frame: Frame) -> None:
        command = frame.variants[1].value if len(frame.variants) > 1 else None
        if command == "GetCurErrorCount":
            self.answers["Controller_Execute"] = S_OK, (Variant(VT.I4, self.count),)
        elif command == "GetCurErrorInfo":
            self.answers["Controller_Execute"] = S_OK, (Variant.array(VT.VARIANT, self.info),)
        super()._execute(frame)


def _read(peer_kind: type[Peer], **answers: Answer | None) -> tuple[tuple[tuple[int, str], ...], Peer]:
    near, far = memory_link_pair()
    peer = peer_kind(far)
    peer.answers.update(answers)

    async def read() -> tuple[tuple[int, str], ...]:
        async with open_session(over_link(near)) as session:
            return await read_errors(Controller(session, 7))

    return run_in_virtual_time(read()), peer


def test_errors_come_as_code_and_text() -> None:
    class OneError(_ErrorPeer):
        info = (Variant(VT.I4, SINGULAR), Variant(VT.BSTR, "singular \ud800"))

    assert _read(OneError)[0] == ((SINGULAR & 0xFFFFFFFF, "singular �"),)


def test_an_error_without_text_is_described() -> None:
    class OneError(_ErrorPeer):
        info = (Variant(VT.I4, SINGULAR),)

    assert _read(OneError)[0] == ((SINGULAR & 0xFFFFFFFF, describe_hresult(SINGULAR).text),)


def test_only_the_newest_errors_are_read() -> None:
    class ManyErrors(_ErrorPeer):
        count = 10_000

    assert len(_read(ManyErrors)[0]) == MAX_ERRORS


def test_a_controller_without_the_commands_is_asked_for_its_variables() -> None:
    errors, peer = _read(
        Peer, Controller_Execute=(E_INVALIDARG, ()), Variable_GetValue=(S_OK, (Variant(VT.I4, SINGULAR),))
    )
    assert errors == ((SINGULAR & 0xFFFFFFFF, str(SINGULAR)),)
    assert peer.functions.count("Controller_GetVariable") == peer.functions.count("Variable_Release") == 2


def test_a_controller_with_no_error_code_has_no_error() -> None:
    refused = E_INVALIDARG, ()
    assert _read(Peer, Controller_Execute=refused, Controller_GetVariable=refused)[0] == ()


def test_a_controller_that_does_not_answer_is_not_free_of_errors() -> None:
    with pytest.raises(CallTimeout):
        _read(Peer, Controller_Execute=None)


def test_errors_are_cleared() -> None:
    near, far = memory_link_pair()
    peer = Peer(far)

    async def clear() -> None:
        async with open_session(over_link(near)) as session:
            await clear_errors(Controller(session, 7))

    run_in_virtual_time(clear())
    assert peer.executed == [("Controller_Execute", 7, "ClearError", None)]
