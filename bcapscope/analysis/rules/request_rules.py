"""Rules about requests with a command or arguments that the controller does not accept."""

from __future__ import annotations

from difflib import get_close_matches

from bcapscope.analysis.client_state import ClientRegistry, ClientState, argument, folded_command
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import NO_REASON, Refusal, RefusalReason, fixed_reason, make_refusal
from bcapscope.analysis.rules.rule_checker import (
    SAME_CALL,
    CallHealth,
    DiagnosisRule,
    OccurrenceSink,
    RuleChecker,
)
from bcapscope.analysis.speech import called, shown
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant, vt_name
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat, parse_format_parameter
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.slave_mode.poses import is_used_axes_mark, pose_numbers
from bcapscope.protocol.tables.command_catalogue import commands_of, find_command
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import E_INVALIDARG, E_NOTIMPL
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

_SEED = "DENSO Wave 2009, How to use the Slave mode"
_SAMPLES = "ShoheiKobata/orin_bcap_python_samples"

FORMAT_REFUSED = DiagnosisRule(
    "format-refused",
    Severity.ERROR,
    "DENSORobot/denso_robot_ros issue 47; DENSORobot/denso_robot_ros2 denso_robot_core",
)
UNKNOWN_COMMAND = DiagnosisRule(
    "unknown-command",
    Severity.ERROR,
    f"orin_bcap C/include/bcap_funcid.h; {_SAMPLES}",
)
ARGUMENT_REFUSED = DiagnosisRule(
    "argument-refused",
    Severity.ERROR,
    f"DENSORobot/denso_robot_ros issues 48 and 52; {_SAMPLES}",
    ("unusual-argument",),
    SAME_CALL,
)
UNUSUAL_ARGUMENT = DiagnosisRule(
    "unusual-argument",
    Severity.NOTE,
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
_MAX_CHECKED = 4096


class RequestChecker(RuleChecker):
    """Checks each mode, and the first set point of each slave-mode session."""

    rules = (UNUSUAL_ARGUMENT,)

    def __init__(self, report_occurrence: OccurrenceSink, clients: ClientRegistry) -> None:
        super().__init__(report_occurrence, clients)
        self._checked: set[Conversation] = set()

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return folded_command(call_kind) in ("slvchangemode", "slvmove")

    def on_call(self, call: Call, client: ClientState) -> None:
        conversation = call.conversation
        if folded_command(call.kind) == "slvmove":
            if conversation not in self._checked:
                if len(self._checked) >= _MAX_CHECKED:
                    self._checked.clear()
                self._checked.add(conversation)
                self._report_odd(call, _odd_point(argument(call, 2), client.generation))
        else:
            self._checked.discard(conversation)
            self._report_odd(call, _odd_mode(argument(call, 2)))

    def drop_client(self, client: ClientState) -> None:
        self._checked.discard(client.conversation)

    def _report_odd(self, call: Call, odd: str) -> None:
        if odd:
            self.report_call(
                UNUSUAL_ARGUMENT,
                call,
                lambda speech: (
                    f"at {speech.at(call.request.time)} {called(call)} of "
                    f"{speech.client(call.conversation)} carries {odd}"
                ),
                group_key=odd,
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
    values = pose_numbers(parameter) or ()
    marked = bool(values) and is_used_axes_mark(values[-1])
    if len(values) in (_DRIVER_COUNTS if marked else _USUAL_COUNTS):
        return ""
    return f"a set point of {len(values)} elements, where P has 7, J 8 and T 10"


def _explain_format(call: Call, client: ClientState, clients: ClientRegistry) -> RefusalReason | None:
    name = folded_command(call.kind)
    parameter = argument(call, 2)
    if name not in ("slvsendformat", "slvrecvformat") or parameter is None:
        return None
    found = parse_format_parameter(parameter)
    if found is None:
        return fixed_reason(f"its parameter is {vt_name(parameter.vt)}, and a number is wanted")
    bits = _send_bits(found.value) if name == "slvsendformat" else _receive_bits(found.value)
    return fixed_reason(f"0x{found.value:03X} asks for {bits}")


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


def _explain_unknown(call: Call, client: ClientState, clients: ClientRegistry) -> RefusalReason | None:
    name = call.kind.command
    if name is None:
        return NO_REASON
    if find_command(call.kind.function_id, name) is not None:
        return fixed_reason("the command is known on other controllers")
    return RefusalReason(lambda speech: _similar_name(call.kind.function_id, name))


def _similar_name(function_id: int, name: str) -> str:
    known = {each.name.casefold(): each.name for each in commands_of(function_id)}
    close = get_close_matches(shown(name).casefold(), known, n=1, cutoff=0.7)
    return f"perhaps {known[close[0]]} was meant" if close else "no known command has a name like that"


def _explain_argument(call: Call, client: ClientState, clients: ClientRegistry) -> RefusalReason | None:
    odd, key = _odd_types(call), shown(call.kind.command or "")
    return RefusalReason(lambda speech: odd, group_key=key) if odd else RefusalReason(group_key=key)


def _odd_types(call: Call) -> str:
    """Describe the first mismatch in number or type of the arguments; empty if they all fit."""
    function, arguments = FUNCTIONS.get(call.kind.function_id), call.request.item.arguments
    if function is None:
        return f"{call.kind.function_id} is no function, there are 137"
    if len(arguments) != len(function.params):
        return f"it has {len(arguments)} arguments, and {function.name} takes {len(function.params)}"
    for param, item in zip(function.params, arguments, strict=True):
        if param.type != "VARIANT" and vt_name(item.variant.vt) != param.type:
            return f"{param.name} is {vt_name(item.variant.vt)}, and {param.type} is usual"
    known = None if call.kind.command is None else find_command(call.kind.function_id, call.kind.command)
    if known is None or not known.parameter_types:
        return ""
    sent = vt_name(arguments[2].variant.vt)
    return (
        ""
        if sent in known.parameter_types
        else f"{sent} was sent, and {known.name} takes {' or '.join(known.parameter_types)}"
    )


REFUSALS: tuple[Refusal, ...] = (
    make_refusal(FORMAT_REFUSED, (), _explain_format),
    make_refusal(UNKNOWN_COMMAND, _NAME_CODES, _explain_unknown),
    make_refusal(ARGUMENT_REFUSED, _TYPE_CODES, _explain_argument),
)
