"""What is opened for a call, what is used again, and how the simulator is told from a robot."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import pytest

from bcapscope.client import open_session, over_link
from bcapscope.client.reach import Reach
from bcapscope.errors import ControllerError
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.protocol.hresult import E_INVALIDARG, S_OK
from bcapscope.protocol.requester import Refused
from bcapscope.protocol.simulated import SIMULATOR_TEXT, SIMULATOR_VARIABLE
from bcapscope.protocol.variant import VT, Variant
from bcapscope.transport.clock import run_virtually
from bcapscope.transport.memory import memory_pair
from tests.client.peer import Answer, Peer

_CONNECT = ("", "provider", "machine", "")


def _play(act: Callable[[Reach], Awaitable[None]], **answers: Answer) -> list[tuple[object, ...]]:
    """Let `act` use a reach; return what the peer executed until then."""

    async def meet() -> list[tuple[object, ...]]:
        near, far = memory_pair()
        peer = Peer(far)
        peer.answers.update(answers)
        async with open_session(over_link(near)) as session:
            await act(Reach(session, ",WDT=400", _CONNECT, {ObjectClass.FILE: "a.pac"}))
            return peer.executed.copy()

    return run_virtually(meet())


def test_everything_is_opened_once() -> None:
    async def act(reach: Reach) -> None:
        await reach.start()
        assert await reach.handle(ObjectClass.FILE) == 102
        assert await reach.handle(ObjectClass.FILE) == 102
        assert await reach.handle(ObjectClass.TASK) == 103
        assert await reach.handle(ObjectClass.MESSAGE) == 104

    assert _play(act) == [
        ("Service_Start", ",WDT=400"),
        ("Controller_Connect", *_CONNECT),
        ("Controller_GetFile", 101, "a.pac", ""),
        ("Controller_GetTask", 101, "RobSlave", ""),
        ("Controller_GetMessage", 101),
    ]


def test_a_provider_that_is_refused_is_told_what_to_do_about() -> None:
    async def act(reach: Reach) -> None:
        with pytest.raises(ControllerError, match=r"RC9 and COBOTTA PRO want CaoProv\.DENSO\.VRC9"):
            await reach.handle(ObjectClass.CONTROLLER)

    _play(act, Controller_Connect=(E_INVALIDARG, ()))


def test_the_newest_is_used_until_it_is_released() -> None:
    async def act(reach: Reach) -> None:
        first = await reach.handle(ObjectClass.ROBOT)
        await reach.invoke("Controller_GetRobot", 101, "Other", "")
        second = await reach.handle(ObjectClass.ROBOT)
        assert second == first + 1
        release = FUNCTIONS[84]
        await reach.exchange(release, (Variant(VT.I4, first),))
        assert await reach.handle(ObjectClass.ROBOT) == second
        await reach.exchange(release, (Variant(VT.I4, second),))
        assert await reach.handle(ObjectClass.ROBOT) == second + 1

    _play(act)


def test_after_service_stop_all_begins_anew() -> None:
    async def act(reach: Reach) -> None:
        await reach.handle(ObjectClass.CONTROLLER)
        await reach.exchange(FUNCTIONS[2], ())
        await reach.handle(ObjectClass.CONTROLLER)

    started = ["Service_Start", "Controller_Connect"]
    assert [call[0] for call in _play(act)] == [*started, "Service_Stop", *started]


def test_what_has_no_usual_name_must_be_named() -> None:
    async def act(reach: Reach) -> None:
        with pytest.raises(ValueError, match="which Extension"):
            await reach.handle(ObjectClass.EXTENSION)

    _play(act)


def test_a_refusal_opens_nothing() -> None:
    async def act(reach: Reach) -> None:
        settled = await reach.exchange(FUNCTIONS[1], (Variant(VT.BSTR, ""),))
        assert isinstance(settled, Refused)
        await reach.exchange(FUNCTIONS[1], (Variant(VT.BSTR, ""),))

    assert len(_play(act, Service_Start=(E_INVALIDARG, ()))) == 2


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
    async def act(reach: Reach) -> None:
        assert await reach.meets_simulator() is met

    executed = _play(act, **answers)
    assert ("Controller_GetVariable", 101, SIMULATOR_VARIABLE, "") in executed
