"""What is opened for a call, what is used again, and how the simulator is told from a robot."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import pytest

from bcapscope.client import open_session
from bcapscope.client.controller_target import ControllerTarget
from bcapscope.client.object_opener import ObjectOpener, read_variable_once
from bcapscope.client.remote_objects import Robot
from bcapscope.errors import ControllerError, RemoteProtocolError
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallRefused
from bcapscope.protocol.tables.function_table import ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, E_INVALIDARG, S_OK
from bcapscope.protocol.tables.simulator_marker import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from tests.client.peer import Answer, Peer
from tests.memory_link import memory_link_pair, over_link
from tests.virtual_time import run_in_virtual_time

_CONNECT = ("", "provider", "machine", "")
_TARGET = ControllerTarget("memory", service=",WDT=400", provider="provider", machine="machine")


def _play(act: Callable[[ObjectOpener], Awaitable[None]], **answers: Answer) -> list[tuple[object, ...]]:
    """Let `act` use an opener; return what the peer executed until then."""

    async def meet() -> list[tuple[object, ...]]:
        near, far = memory_link_pair()
        peer = Peer(far)
        peer.answers.update(answers)
        async with open_session(over_link(near)) as session:
            await act(ObjectOpener(session, _TARGET, {ObjectClass.FILE: "a.pac"}))
            return peer.executed.copy()

    return run_in_virtual_time(meet())


def test_everything_is_opened_once() -> None:
    async def act(opener: ObjectOpener) -> None:
        await opener.start_service()
        assert await opener.handle_for(ObjectClass.FILE) == 102
        assert await opener.handle_for(ObjectClass.FILE) == 102
        assert await opener.handle_for(ObjectClass.TASK) == 103
        assert await opener.handle_for(ObjectClass.MESSAGE) == 104

    assert _play(act) == [
        ("Service_Start", ",WDT=400"),
        ("Controller_Connect", *_CONNECT),
        ("Controller_GetFile", 101, "a.pac", ""),
        ("Controller_GetTask", 101, "RobSlave", ""),
        ("Controller_GetMessage", 101),
    ]


def test_a_provider_that_is_refused_is_told_what_to_do_about() -> None:
    async def act(opener: ObjectOpener) -> None:
        with pytest.raises(ControllerError, match=r"RC9 and COBOTTA PRO need CaoProv\.DENSO\.VRC9"):
            await opener.handle_for(ObjectClass.CONTROLLER)

    _play(act, Controller_Connect=(E_INVALIDARG, ()))


def test_the_newest_is_used_until_it_is_released() -> None:
    async def act(opener: ObjectOpener) -> None:
        first = await opener.handle_for(ObjectClass.ROBOT)
        await opener.session.invoke("Controller_GetRobot", 101, "Other", "")
        second = await opener.handle_for(ObjectClass.ROBOT)
        assert second == first + 1
        await opener.session.perform_call(84, (Variant(VT.I4, first),))
        assert await opener.handle_for(ObjectClass.ROBOT) == second
        await opener.session.perform_call(84, (Variant(VT.I4, second),))
        assert await opener.handle_for(ObjectClass.ROBOT) == second + 1

    _play(act)


def test_after_service_stop_all_begins_anew() -> None:
    async def act(opener: ObjectOpener) -> None:
        await opener.handle_for(ObjectClass.CONTROLLER)
        await opener.session.perform_call(2, ())
        await opener.handle_for(ObjectClass.CONTROLLER)

    started = ["Service_Start", "Controller_Connect"]
    assert [call[0] for call in _play(act)] == [*started, "Service_Stop", *started]


def test_what_has_no_usual_name_must_be_named() -> None:
    async def act(opener: ObjectOpener) -> None:
        with pytest.raises(ValueError, match="the Extension has no known name"):
            await opener.handle_for(ObjectClass.EXTENSION)

    _play(act)


def test_a_refusal_opens_nothing() -> None:
    async def act(opener: ObjectOpener) -> None:
        settled = await opener.session.perform_call(1, (Variant(VT.BSTR, ""),))
        assert isinstance(settled, CallRefused)
        await opener.session.perform_call(1, (Variant(VT.BSTR, ""),))

    assert len(_play(act, Service_Start=(E_INVALIDARG, ()))) == 2


def test_each_provider_is_tried_until_one_is_known() -> None:
    async def act(opener: ObjectOpener) -> None:
        with pytest.raises(ControllerError):
            await opener.connect_controller(("a", "b"))

    executed = _play(act, Controller_Connect=(E_INVALIDARG, ()))
    assert [call[2] for call in executed] == ["a", "b"]


def test_a_provider_that_is_known_ends_the_search() -> None:
    async def act(opener: ObjectOpener) -> None:
        assert await opener.connect_controller(("a", "b")) == "a"

    assert [call[2] for call in _play(act)] == ["a"]


def test_another_refusal_ends_the_search() -> None:
    async def act(opener: ObjectOpener) -> None:
        with pytest.raises(ControllerError):
            await opener.connect_controller(("a", "b"))

    assert [call[2] for call in _play(act, Controller_Connect=(E_HANDLE, ()))] == ["a"]


def test_a_variable_stays_open_for_the_next_reading() -> None:
    async def act(opener: ObjectOpener) -> None:
        for _ in range(2):
            value = await opener.read_variable(ObjectClass.ROBOT, "@SPEED")
            assert value.value == 5
        await opener.read_variable(ObjectClass.CONTROLLER, "@SPEED")

    executed = _play(act, Variable_GetValue=(S_OK, (Variant(VT.I4, 5),)))
    assert [call[:3] for call in executed if "GetVariable" in str(call[0])] == [
        ("Robot_GetVariable", 102, "@SPEED"),
        ("Controller_GetVariable", 101, "@SPEED"),
    ]


def test_a_variable_without_a_value_cannot_be_read() -> None:
    async def act(opener: ObjectOpener) -> None:
        with pytest.raises(RemoteProtocolError, match="@SPEED has no value"):
            await opener.read_variable(ObjectClass.ROBOT, "@SPEED")

    _play(act, Variable_GetValue=(S_OK, ()))


def test_a_variable_that_is_read_once_is_released_though_reading_is_refused() -> None:
    async def act(opener: ObjectOpener) -> None:
        robot = await opener.open_remote(Robot)
        assert await read_variable_once(robot, "@SPEED") is None

    refused = E_INVALIDARG, ()
    executed = _play(act, Variable_GetValue=refused, Variable_Release=refused)
    assert executed[-1] == ("Variable_Release", 103)


_SIMULATOR = Variant(VT.BSTR, SIMULATOR_TEXT)


@pytest.mark.parametrize(
    ("answers", "met"),
    [
        ({"Variable_GetValue": (S_OK, (_SIMULATOR,))}, True),
        ({"Variable_GetValue": (S_OK, (Variant(VT.BSTR, "a controller"),))}, False),
        ({"Variable_GetValue": (S_OK, ())}, False),
        ({"Controller_GetVariable": (E_INVALIDARG, ())}, False),
        ({"Variable_GetValue": (E_INVALIDARG, ())}, False),
    ],
)
def test_only_the_simulator_says_that_it_is_one(answers: dict[str, Answer], met: bool) -> None:
    async def act(opener: ObjectOpener) -> None:
        assert await opener.is_simulator() is met

    executed = _play(act, **answers)
    assert ("Controller_GetVariable", 101, SIMULATOR_VARIABLE, "") in executed
