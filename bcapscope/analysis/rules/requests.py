"""Requests whose arguments or command are not what the controller takes."""

from __future__ import annotations

from difflib import get_close_matches

from bcapscope.analysis.client import Client, Clients, argument, command_of
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import NO_MORE, Refusal, Why, fixed, refusal
from bcapscope.analysis.rules.rule import OF_ITSELF, Kind, Report, Rule, Watcher
from bcapscope.analysis.speech import called, shown
from bcapscope.protocol.commands import command, commands
from bcapscope.protocol.functions import FUNCTIONS
from bcapscope.protocol.hresult import E_INVALIDARG, E_NOTIMPL
from bcapscope.protocol.poses import is_driver_mark, numbers
from bcapscope.protocol.slaveformat import ReceiveFormat, SendFormat, format_parameter
from bcapscope.protocol.slavemode import Generation
from bcapscope.protocol.variant import ARRAY, VT, Variant, vt_name
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_SAMPLES = "ShoheiKobata/orin_bcap_python_samples"

FORMAT = Rule(
    "format-refused",
    Severity.ERROR,
    "slvSendFormat or slvRecvFormat is refused",
    "Leave out the bits that this controller does not have: an RC8 needs 1.4.0 for formats, and 1.5.8 "
    "refuses 0x120 (hand and mini I/O together).",
    "DENSORobot/denso_robot_ros issue 47; DENSORobot/denso_robot_ros2 denso_robot_core",
)
UNKNOWN = Rule(
    "unknown-command",
    Severity.ERROR,
    "a command or function is not known to the controller",
    "Check the spelling (case does not matter), the object that it is sent to, and whether this "
    "controller has it.",
    f"orin_bcap C/include/bcap_funcid.h; {_SAMPLES}",
)
ARGUMENT = Rule(
    "argument-refused",
    Severity.ERROR,
    "a call is refused for an argument",
    "Compare types and order of the arguments with the command's; options are texts, states numbers.",
    f"DENSORobot/denso_robot_ros issues 48 and 52; {_SAMPLES}",
    ("unusual-argument",),
    OF_ITSELF,
)
UNUSUAL = Rule(
    "unusual-argument",
    Severity.NOTE,
    "slvChangeMode or slvMove carry another type or number of elements than usual",
    "If it works, leave it; if it is refused, send the mode as VT_I4, and set points as VT_R8|VT_ARRAY "
    "(VT_R4 on RC7) with 7 elements for P, 8 for J, 10 for T.",
    f"{_SEED}; {_SAMPLES}; DENSORobot/denso_robot_ros2 denso_robot_core",
)

_TYPE_CODES = (
    E_INVALIDARG,
    0x80020005,
    0x80020008,
    0x8002000A,
    0x8002000B,
    0x80010003,
    0x80000203,
    0x83500127,
)
_NAME_CODES = (0x80010005, 0x80000904, E_NOTIMPL)
_USUAL_COUNTS = (7, 8, 10)
_DRIVER_COUNTS = (8, 9, 11)
_R4S, _R8S = ARRAY | VT.R4, ARRAY | VT.R8
_MOST_SEEN = 4096


class Requests(Watcher):
    """Looks at the arguments of the calls that slave mode consists of, once for each client and stay."""

    rules = (UNUSUAL,)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._looked_at: set[Conversation] = set()

    def heeds(self, question: Question, kind: Kind) -> bool:
        return command_of(question) in ("slvchangemode", "slvmove")

    def call(self, call: Exchange, client: Client) -> None:
        conversation = call.conversation
        if command_of(call.question) == "slvmove":
            if conversation not in self._looked_at:
                if len(self._looked_at) >= _MOST_SEEN:
                    self._looked_at.clear()
                self._looked_at.add(conversation)
                self._look_at(call, _odd_point(argument(call, 2), client.generation))
        else:
            self._looked_at.discard(conversation)
            self._look_at(call, _odd_mode(argument(call, 2)))

    def gone(self, client: Client, ended: int) -> None:
        self._looked_at.discard(client.conversation)

    def _look_at(self, call: Exchange, odd: str) -> None:
        if odd:
            self.tell(
                UNUSUAL,
                call,
                lambda speech: (
                    f"at {speech.at(call.request.time)} {called(call)} of "
                    f"{speech.client(call.conversation)} carries {odd}"
                ),
                key=odd,
            )


def _odd_mode(parameter: Variant | None) -> str:
    if parameter is None or parameter.vt in (VT.I2, VT.I4):
        return ""
    value = f" '{shown(parameter.value)}'" if isinstance(parameter.value, str) else ""
    return f"its mode as {vt_name(parameter.vt)}{value}, where VT_I4 or VT_I2 is usual"


def _odd_point(parameter: Variant | None, generation: Generation | None) -> str:
    if parameter is None or parameter.vt not in (_R4S, _R8S):
        return ""
    if parameter.vt == _R4S and generation is Generation.RC8:
        return "a set point as VT_R4|VT_ARRAY, where VT_R8|VT_ARRAY is usual on this controller"
    values = numbers(parameter) or ()
    marked = bool(values) and is_driver_mark(values[-1])
    if len(values) in (_DRIVER_COUNTS if marked else _USUAL_COUNTS):
        return ""
    return f"a set point of {len(values)} elements, where P has 7, J 8 and T 10"


def _format(call: Exchange, client: Client, clients: Clients) -> Why | None:
    name = command_of(call.question)
    parameter = argument(call, 2)
    if name not in ("slvsendformat", "slvrecvformat") or parameter is None:
        return None
    found = format_parameter(parameter)
    if found is None:
        return fixed(f"its parameter is {vt_name(parameter.vt)}, and a number is wanted")
    bits = _send_bits(found.value) if name == "slvsendformat" else _receive_bits(found.value)
    return fixed(f"0x{found.value:03X} asks for {bits}")


def _send_bits(value: int) -> str:
    form = SendFormat.parse(value)
    named = (
        ("hand I/O (0x020)", form.hand_io),
        ("mini I/O (0x100)", form.mini_io),
        ("user I/O (0x200)", form.user_io),
    )
    return _listed([text for text, there in named if there], form.other)


def _receive_bits(value: int) -> str:
    form = ReceiveFormat.parse(value)
    named = (
        ("pose " + "+".join(form.poses), bool(form.poses)),
        ("time stamp (0x010)", form.timestamp),
        ("hand I/O (0x020)", form.hand_io),
        ("motor current (0x040)", form.current),
        ("mini I/O (0x100)", form.mini_io),
        ("user I/O (0x200)", form.user_io),
    )
    return _listed([text for text, there in named if there], form.other)


def _listed(parts: list[str], other: int) -> str:
    if other:
        parts.append(f"bits without a known meaning (0x{other & 0xFFFFFFFF:X})")
    return " and ".join(parts) or "nothing"


def _unknown(call: Exchange, client: Client, clients: Clients) -> Why | None:
    name = call.question.command
    if name is None:
        return NO_MORE
    if command(call.question.function_id, name) is not None:
        return fixed("the command is known on other controllers")
    return Why(lambda speech: _guess(call.question.function_id, name))


def _guess(function_id: int, name: str) -> str:
    known = {each.name.casefold(): each.name for each in commands(function_id)}
    close = get_close_matches(shown(name).casefold(), known, n=1, cutoff=0.7)
    return f"perhaps {known[close[0]]} was meant" if close else "no known command has a name like that"


def _argument(call: Exchange, client: Client, clients: Clients) -> Why | None:
    odd, key = _odd_types(call), shown(call.question.command or "")
    return Why(lambda speech: odd, key=key) if odd else Why(key=key)


def _odd_types(call: Exchange) -> str:
    """Tell which argument has another type than the function or the command takes."""
    function, arguments = FUNCTIONS.get(call.question.function_id), call.request.item.arguments
    if function is None:
        return f"{call.question.function_id} is no function, there are 137"
    if len(arguments) != len(function.params):
        return f"it has {len(arguments)} arguments, and {function.name} takes {len(function.params)}"
    for param, item in zip(function.params, arguments, strict=True):
        if param.type != "VARIANT" and vt_name(item.variant.vt) != param.type:
            return f"{param.name} is {vt_name(item.variant.vt)}, and {param.type} is usual"
    known = (
        None if call.question.command is None else command(call.question.function_id, call.question.command)
    )
    if known is None or not known.parameter_types:
        return ""
    sent = vt_name(arguments[2].variant.vt)
    return (
        ""
        if sent in known.parameter_types
        else f"{sent} was sent, and {known.name} takes {' or '.join(known.parameter_types)}"
    )


REFUSALS: tuple[Refusal, ...] = (
    refusal(FORMAT, (), _format),
    refusal(UNKNOWN, _NAME_CODES, _unknown),
    refusal(ARGUMENT, _TYPE_CODES, _argument),
)
