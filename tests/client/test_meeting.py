"""Client and simulator meet in memory, under virtual time and over networks of every kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.client import RetryPolicies, Session, connect, open_session
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.requester import CallAnswered, CallRefused, CallTimedOut, RetryPolicy
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.simulator.call_executor import CallReport
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.simulator import Peer, Simulator
from tests.client.simulated import Controller
from tests.memory_link import memory_link_pair, over_link
from tests.virtual_time import run_in_virtual_time

_PUT_TAG, _GET_TAG = 23, 22
_UDP = [ReservedConvention.SEED, ReservedConvention.OWN, ReservedConvention.CHAIN]


@pytest.mark.parametrize("profile", sorted(PROFILES))
@pytest.mark.parametrize("datagrams", [True, False])
def test_a_session(profile: str, datagrams: bool) -> None:
    async def play() -> None:
        simulator = Simulator(PROFILES[profile])
        near, far = memory_link_pair(datagrams=datagrams)
        Controller(simulator).plug("client", far)
        async with connect(over_link(near)) as service:
            provider = "CaoProv.DENSO.VRC9" if profile == "rc9" else "CaoProv.DENSO.VRC"
            controller = await service.connect("", provider, "localhost")
            robot = await controller.get_robot("Arm")
            assert await robot.slv_get_mode() == 0
            variable = await controller.get_variable("I1")
            await variable.put_value(7)
            assert await variable.get_value() == 7

    run_in_virtual_time(play())


class _Network:
    """Loses, delays and doubles packets, as drawn; later ones go through."""

    def __init__(self, fates: Iterable[list[float]]) -> None:
        self._fates: Iterator[list[float]] = iter(fates)

    def fate(self, _: bytes) -> Iterable[float]:
        """Return when the copies of a packet arrive."""
        return next(self._fates, [0.0])


_FATES = st.lists(st.lists(st.sampled_from([0.0, 0.0005, 0.0015, 0.003, 0.009]), max_size=2), max_size=60)
_ACTIONS = st.lists(st.sampled_from(["put", "put", "put", "get", "restart"]), min_size=1, max_size=14)


@given(st.sampled_from(_UDP), st.integers(0, 7), _ACTIONS, _FATES, _FATES)
def test_every_call_ends_in_one_way_and_none_runs_twice(
    convention: ReservedConvention,
    retries: int,
    actions: list[str],
    up: list[list[float]],
    down: list[list[float]],
) -> None:
    ran: Counter[object] = Counter()

    def note(_: Peer, report: CallReport) -> None:
        if report.function_id == _PUT_TAG:
            ran[report.arguments[1].value] += 1

    paces = RetryPolicies(others=RetryPolicy(2_000_000, retries))
    simulator = Simulator(PROFILES["rc8"], report=note)
    networks = _Network(up), _Network(down)
    succeeded = run_in_virtual_time(_client(simulator, convention, paces, actions, networks))
    assert all(times == 1 for times in ran.values())
    assert succeeded <= set(ran)


async def _client(
    simulator: Simulator,
    convention: ReservedConvention,
    paces: RetryPolicies,
    actions: list[str],
    networks: tuple[_Network, _Network],
) -> set[object]:
    """Act over the network, a restart being a new program from the same port; return what was put."""
    controller = Controller(simulator)
    todo = list(enumerate(actions))
    put: set[object] = set()
    while todo:
        near, far = memory_link_pair(networks[0].fate, networks[1].fate)
        controller.plug("client", far)
        async with open_session(over_link(near), convention=convention, retry_policies=paces) as session:
            handle = await _begin(session)
            while todo and todo[0][1] != "restart":
                number, action = todo.pop(0)
                value = Variant(VT.I4, number)
                function, arguments = (
                    (_PUT_TAG, (handle, value)) if action == "put" else (_GET_TAG, (handle,))
                )
                settled = await session.perform_call(function, arguments)
                assert isinstance(settled, CallAnswered | CallRefused | CallTimedOut)
                if isinstance(settled, CallAnswered) and action == "put":
                    put.add(number)
            todo = todo[1:]
    return put


async def _begin(session: Session) -> Variant:
    """Start and connect; return the handle, a wrong one where that did not succeed."""
    await session.perform_call(1, (Variant(VT.BSTR, ""),))
    names = ("", "CaoProv.DENSO.VRC", "localhost", "")
    settled = await session.perform_call(3, [Variant(VT.BSTR, name) for name in names])
    if isinstance(settled, CallAnswered) and settled.reply.arguments:
        return settled.reply.arguments[0].variant
    return Variant(VT.I4, -1)
