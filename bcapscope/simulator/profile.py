"""Profiles: how the answers of the simulated controller depend on the controller's generation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from bcapscope.protocol.codec.variant import VT
from bcapscope.protocol.retry.reserved_convention import ReplyReserved
from bcapscope.protocol.retry.responder import Defect
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.tables.command_catalogue import COBOTTA, COBOTTA_PRO, commands_of

_CONTROLLER_EXECUTE, _ROBOT_EXECUTE = 17, 64


def _documented_for(function_id: int, *controllers: str) -> frozenset[str]:
    """Return the lower-case names of the commands that the command catalogue lists only for `controllers`."""
    return frozenset(
        each.name.casefold() for each in commands_of(function_id) if each.controllers in controllers
    )


_HAND = _documented_for(_CONTROLLER_EXECUTE, COBOTTA)
_TWO_FINGER_HAND = _documented_for(_ROBOT_EXECUTE, COBOTTA_PRO)
_RC8_ONLY = (
    frozenset(("slvsendformat", "slvrecvformat", "manualreset", "resetstostate", "stostate", "takearmstate"))
    | _HAND
    | _TWO_FINGER_HAND
    | _documented_for(_ROBOT_EXECUTE, COBOTTA)
)
_RC7_ONLY = frozenset(("putautomode", "getautomode"))


class NoArgument(StrEnum):
    """Selects the replies that contain no VARIANT if a call has no value to return. In all other replies, a
    VARIANT of type VT_EMPTY stands for the missing value.

    `NoArgument` affects only functions that can return a value. If the reply to such a function contains no
    VARIANT, DENSO's C# and Java clients throw an exception.
    """

    NEVER = "never"
    SLVCHANGEMODE = "slvchangemode"
    ALWAYS = "always"


@dataclass(frozen=True, slots=True)
class Profile:
    """One kind of controller.

    Attributes:
        name: Argument of `--profile`; `title` is the name that messages show.
        mode_type: VARIANT type of slvGetMode's result.
        real: VARIANT type of the numbers in a pose.
        providers: Provider names that Controller_Connect accepts; () if the controller ignores the name.
        running_result: Result code of slvChangeMode if the robot did not stand still in time.
        lacks: Commands that the controller does not know, in lower case.
    """

    name: str
    title: str
    generation: Generation
    replies: ReplyReserved
    no_argument: NoArgument
    mode_type: VT
    real: VT
    providers: tuple[str, ...]
    needs_robslave: bool
    needs_arm: bool
    running_result: int
    lacks: frozenset[str]
    version: str
    defects: Defect = Defect.NONE


_RC8 = Profile(
    name="rc8",
    title="RC8, RC8A, COBOTTA",
    generation=Generation.RC8,
    replies=ReplyReserved.ZERO,
    no_argument=NoArgument.NEVER,
    mode_type=VT.I4,
    real=VT.R8,
    providers=("CaoProv.DENSO.VRC",),
    needs_robslave=False,
    needs_arm=True,
    running_result=0x8150100D,
    lacks=_RC7_ONLY | _TWO_FINGER_HAND,
    version="2.0.0",
)

_RC7 = replace(
    _RC8,
    name="rc7",
    title="RC7",
    generation=Generation.RC7,
    replies=ReplyReserved.ECHOED,
    no_argument=NoArgument.SLVCHANGEMODE,
    mode_type=VT.I2,
    real=VT.R4,
    providers=(),
    needs_robslave=True,
    needs_arm=False,
    running_result=0x0000600B,
    lacks=_RC8_ONLY,
    version="3.0.0",
)
_RC9 = replace(
    _RC8,
    name="rc9",
    title="RC9, COBOTTA PRO",
    providers=("CaoProv.DENSO.VRC9",),
    lacks=_RC7_ONLY | _HAND,
    version="1.0.0",
)
_CSERVER = replace(
    _RC8,
    name="cserver",
    title="DENSO's C server with the commands of an RC8",
    defects=Defect.FORGETS_FIRST | Defect.SERIAL_ZERO,
)

PROFILES: Mapping[str, Profile] = {profile.name: profile for profile in (_RC7, _RC8, _RC9, _CSERVER)}

DEFAULT_PROFILE = "rc8"
