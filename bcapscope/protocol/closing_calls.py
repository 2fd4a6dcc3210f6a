"""The calls that close a session. A client makes these calls, or the proxy makes them for a client that is
gone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from bcapscope.protocol.codec.variant import EMPTY, VT, Variant
from bcapscope.protocol.tables.function_table import FUNCTIONS, ID, Function, ObjectClass

RELEASES: Mapping[ObjectClass, Function] = {
    function.releases: function for function in FUNCTIONS.values() if function.releases is not None
}

ClosingCall = tuple[int, tuple[Variant, ...]]


def closing_calls(
    robots: Iterable[int],
    arms: Iterable[int],
    objects: Iterable[tuple[ObjectClass, int]],
    *,
    stops_service: bool = True,
) -> Iterator[ClosingCall]:
    """Yield the calls that close a session, in order: end slave mode (`robots`), release the arms (`arms`),
    release the `objects` (callers list the newest first), stop the service. No closing call moves a robot.
    """
    for handle in robots:
        yield _robot_command(handle, "slvChangeMode", Variant(VT.I4, 0))
    for handle in arms:
        yield _robot_command(handle, "GiveArm", EMPTY)
    for kind, handle in objects:
        yield RELEASES[kind].id, (Variant(VT.I4, handle),)
    if stops_service:
        yield ID["Service_Stop"], ()


def _robot_command(handle: int, command: str, parameter: Variant) -> ClosingCall:
    return ID["Robot_Execute"], (Variant(VT.I4, handle), Variant(VT.BSTR, command), parameter)
