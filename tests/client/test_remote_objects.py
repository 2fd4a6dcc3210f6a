"""Each of the 137 functions is a method with the right arguments and result."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from datetime import datetime
from typing import Any

import pytest

from bcapscope.client import Controller, ControllerMessage, Robot, connect, remote_objects
from bcapscope.client.remote_object import RemoteObject
from bcapscope.client.remote_objects import Service
from bcapscope.errors import ControllerError, RemoteProtocolError
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, S_OK
from tests.client.peer import Answer, Peer
from tests.memory_link import memory_link_pair, over_link
from tests.virtual_time import run_in_virtual_time

_SAMPLES = {"str": "x", "int": 3, "float": 1.5, "object": (1, 2)}
_CLASSES = {
    kind.owner: kind
    for kind in vars(remote_objects).values()
    if isinstance(kind, type) and issubclass(kind, RemoteObject) and "owner" in vars(kind)
}


def _methods(kind: type) -> list[str]:
    names = [name for name, member in inspect.getmembers(kind, inspect.iscoroutinefunction)]
    return [name for name in names if not name.startswith(("_", "slv_"))]


def _sample_arguments(method: Callable[..., object]) -> list[object]:
    return [_SAMPLES[parameter.annotation] for parameter in inspect.signature(method).parameters.values()]


def _run(
    play: Callable[[Service, Peer], Awaitable[None]], answers: dict[str, Answer | None] | None = None
) -> Peer:
    """Run a play between a client and a peer."""

    async def meet() -> Peer:
        near, far = memory_link_pair()
        peer = Peer(far)
        peer.answers = answers or {}
        async with connect(over_link(near)) as service:
            await play(service, peer)
        return peer

    return run_in_virtual_time(meet())


def test_every_function_is_called_with_its_own_arguments_by_some_method() -> None:
    async def call_all(service: Service, peer: Peer) -> None:
        await service.connect("name", "provider", "machine", "option")
        for kind in _CLASSES.values():
            for name in _methods(kind):
                method = getattr(kind(service.session, 7), name)
                await method(*_sample_arguments(method))

    peer = _run(call_all)
    assert set(peer.functions) == {function.name for function in FUNCTIONS.values()}
    for name, *values in peer.executed:
        (function,) = [one for one in FUNCTIONS.values() if one.name == name]
        assert len(values) == len(function.params)
        if function.params and function.params[0].name[0] == "h":
            assert values[0] == 7 or function.releases


def test_the_order_of_arguments() -> None:
    async def play(service: Service, peer: Peer) -> None:
        robot = Robot(service.session, 7)
        await robot.accelerate(-1, 50.0, 60.0)
        await robot.move(1, "@E J(1)", "NEXT")
        await robot.rotate((1, 2), 90.0, None, "@0")

    peer = _run(play)
    assert peer.executed[1:-1] == [
        ("Robot_Accelerate", 7, -1, 50.0, 60.0),
        ("Robot_Move", 7, 1, "@E J(1)", "NEXT"),
        ("Robot_Rotate", 7, (1, 2), 90.0, None, "@0"),
    ]


async def _results(service: Service, peer: Peer) -> None:
    controller = Controller(service.session, 7)
    assert await controller.get_attribute() == 5
    assert await controller.get_help() == "text"
    assert await controller.execute("SysState") == (1.0, 2.0)
    assert await controller.get_robot_names() == ("a", "b")
    assert await ControllerMessage(service.session, 7).get_date_time() == datetime(1970, 1, 1, 12)
    assert (await controller.get_robot("Arm")).handle == 101


def test_results_have_the_types_of_python() -> None:
    _run(_results)


@pytest.mark.parametrize(
    ("function", "answer"),
    [
        ("Robot_GetAttribute", ()),
        ("Robot_GetHelp", (Variant(VT.I4, 1),)),
        ("Robot_GetVariable", (Variant(VT.BSTR, "1"),)),
        ("Robot_GetVariableNames", (Variant(VT.I4, 1),)),
        ("Robot_GetVariableNames", (Variant.array(VT.VARIANT, (Variant(VT.I4, 1),)),)),
        ("Variable_GetDateTime", (Variant(VT.DATE, 1e300),)),
        ("Variable_GetDateTime", (Variant(VT.BSTR, "now"),)),
    ],
)
def test_answers_of_the_wrong_type(function: str, answer: tuple[Variant, ...]) -> None:
    owner, _, verb = function.partition("_")
    method = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in verb)[1:]

    async def play(service: Service, peer: Peer) -> None:
        call: Any = getattr(_CLASSES[ObjectClass(owner)](service.session, 7), method)
        with pytest.raises(RemoteProtocolError, match="the reply holds"):
            await call(*_sample_arguments(call))

    _run(play, {function: (S_OK, answer)})


def test_an_answer_without_a_value() -> None:
    """RC7 answers slvChangeMode with no argument at all."""

    async def play(service: Service, peer: Peer) -> None:
        robot = Robot(service.session, 7)
        assert await robot.execute("slvChangeMode", Variant(VT.I2, 0)) is None
        assert await robot.get_variable_names() == ()

    _run(play, {"Robot_Execute": (S_OK, ()), "Robot_GetVariableNames": (S_OK, (Variant(VT.EMPTY, None),))})


def test_a_refusal_is_told_with_its_meaning() -> None:
    async def play(service: Service, peer: Peer) -> None:
        with pytest.raises(ControllerError, match=r"Robot_Execute CurJnt was refused: E_HANDLE") as caught:
            await Robot(service.session, 7).execute("CurJnt")
        assert caught.value.hresult == E_HANDLE

    _run(play, {"Robot_Execute": (E_HANDLE, ())})


def test_an_object_is_released_at_the_end_of_its_block_and_not_twice() -> None:
    async def play(service: Service, peer: Peer) -> None:
        async with await service.connect() as controller, await controller.get_robot("Arm") as robot:
            assert robot.handle == 102

    assert _run(play).functions == [
        "Service_Start",
        "Controller_Connect",
        "Controller_GetRobot",
        "Robot_Release",
        "Controller_Disconnect",
        "Service_Stop",
    ]


def test_slave_mode() -> None:
    async def play(service: Service, peer: Peer) -> None:
        robot = Robot(service.session, 7)
        await robot.slv_change_mode(2)
        assert await robot.slv_move([0.0] * 8) == (1.0, 2.0)
        with pytest.raises(RemoteProtocolError):
            await robot.slv_get_mode()

    assert _run(play).executed[1:-1] == [
        ("Robot_Execute", 7, "slvChangeMode", 2),
        ("Robot_Execute", 7, "slvMove", (0.0,) * 8),
        ("Robot_Execute", 7, "slvGetMode", None),
        ("Robot_Execute", 7, "slvChangeMode", 0),
    ]
