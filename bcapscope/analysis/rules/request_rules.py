"""Rules about requests whose command or arguments the controller does not accept."""

from __future__ import annotations

from bcapscope.analysis.call_arguments import argument
from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_places
from bcapscope.analysis.rules.rule_checker import NO_REASON, CallHealth, Refusal, RefusalReason, RuleChecker
from bcapscope.analysis.slave.generation_clues import ENOUGH_TO_OBJECT
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Listing, WireText, shortened
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant, vt_name
from bcapscope.protocol.slave_mode.formats import ReceiveFormat, SendFormat, parse_format_parameter
from bcapscope.protocol.slave_mode.modes import Generation
from bcapscope.protocol.slave_mode.poses import is_used_axes_mark, pose_numbers
from bcapscope.protocol.tables.command_catalogue import find_command, similar_command
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.protocol.tables.hresult import E_INVALIDARG, E_NOTIMPL
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.observation import Conversation

_TYPE_CODES = (
    *(E_INVALIDARG, 0x80020005, 0x80020008, 0x8002000A),
    *(0x8002000B, 0x80010003, 0x80000203, 0x83500127),
)
_NAME_CODES = (0x80010005, 0x80000904, E_NOTIMPL)
_USUAL_COUNTS = (7, 8, 10)
_DRIVER_COUNTS = (8, 9, 11)
_R4S, _R8S = ARRAY | VT.R4, ARRAY | VT.R8


class RequestChecker(RuleChecker):
    by_client: dict[Conversation, bool]

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        return call_kind.folded_command in ("slvchangemode", "slvmove")

    def on_call(self, call: Call, client: ClientState) -> None:
        conversation = call.conversation
        if call.kind.folded_command == "slvmove":
            if conversation not in self.by_client:
                self.by_client[conversation] = True
                is_known = client.generation_clue.strength >= ENOUGH_TO_OBJECT
                generation = client.generation if is_known else None
                self._report_odd(call, _odd_point(argument(call, 2), generation))
        else:
            self.by_client.pop(conversation, None)
            self._report_odd(call, _odd_mode(argument(call, 2)))

    def _report_odd(self, call: Call, detail: Message | None) -> None:
        if detail is not None:
            fact = Message("finding.unusual-argument", **call_places(call), detail=detail)
            self.report_call("unusual-argument", call, fact, group_key=repr(detail))


def _odd_mode(parameter: Variant | None) -> Message | None:
    if parameter is None or parameter.vt in (VT.I2, VT.I4):
        return None
    if isinstance(parameter.value, str):
        value = WireText(shortened(parameter.value))
        return Message("finding.unusual-argument.mode.value", type=vt_name(parameter.vt), value=value)
    return Message("finding.unusual-argument.mode", type=vt_name(parameter.vt))


def _odd_point(parameter: Variant | None, generation: Generation | None) -> Message | None:
    if parameter is None or parameter.vt not in (_R4S, _R8S):
        return None
    if parameter.vt == _R4S and generation is Generation.RC8:
        return Message("finding.unusual-argument.set-point.type")
    values = pose_numbers(parameter) or ()
    marked = bool(values) and is_used_axes_mark(values[-1])
    if len(values) in (_DRIVER_COUNTS if marked else _USUAL_COUNTS):
        return None
    return Message("finding.unusual-argument.set-point.size", elements=Count(len(values), "element"))


def _explain_format(call: Call, client: ClientState) -> RefusalReason | None:
    name = call.kind.folded_command
    parameter = argument(call, 2)
    if name not in ("slvsendformat", "slvrecvformat") or parameter is None:
        return None
    found = parse_format_parameter(parameter)
    if found is None:
        return RefusalReason(Message("reason.format-type", type=vt_name(parameter.vt)))
    form = (SendFormat if name == "slvsendformat" else ReceiveFormat).parse(found.value)
    parts = _format_parts(form)
    return RefusalReason(Message("reason.format", format=f"0x{found.value:03X}", parts=parts))


def _format_parts(form: SendFormat | ReceiveFormat) -> Listing:
    poses = "+".join(form.poses) if isinstance(form, ReceiveFormat) else ""
    parts = [Message("format.pose", poses=poses)] if poses else []
    for part in ("timestamp", "hand-io", "current", "mini-io", "user-io"):
        if getattr(form, part.replace("-", "_"), False):
            parts.append(Message(f"format.{part}"))
    if form.other:
        parts.append(Message("format.unknown", bits=f"0x{form.other & 0xFFFFFFFF:X}"))
    return Listing(tuple(parts) or (Message("format.nothing"),))


def _explain_unknown(call: Call, client: ClientState) -> RefusalReason | None:
    name = call.kind.command
    if name is None:
        return NO_REASON
    if find_command(call.kind.function_id, name) is not None:
        return RefusalReason(Message("reason.command-elsewhere"))
    similar = similar_command(call.kind.function_id, name)
    if similar is None:
        return RefusalReason(Message("reason.command-unknown"))
    return RefusalReason(Message("reason.command-similar", command=similar))


def _explain_argument(call: Call, client: ClientState) -> RefusalReason | None:
    return RefusalReason(_argument_mismatch(call), group_key=shortened(call.kind.command or ""))


def _argument_mismatch(call: Call) -> Message | None:
    function, arguments = FUNCTIONS.get(call.kind.function_id), call.request.item.arguments
    if function is None:
        return Message("reason.no-function", function=call.kind.function_id)
    if len(arguments) != len(function.params):
        return Message(
            "reason.argument-count",
            sent=Count(len(arguments), "argument"),
            function=function.name,
            wanted=len(function.params),
        )
    for param, item in zip(function.params, arguments, strict=True):
        sent = vt_name(item.variant.vt)
        if param.type not in ("VARIANT", sent):
            return Message("reason.argument-type", argument=param.name, sent=sent, usual=param.type)
    known = None if call.kind.command is None else find_command(call.kind.function_id, call.kind.command)
    if known is None or not known.parameter_types:
        return None
    sent = vt_name(arguments[2].variant.vt)
    if sent in known.parameter_types:
        return None
    types = ", ".join(known.parameter_types)
    case = "" if len(known.parameter_types) == 1 else ".several"
    return Message(f"reason.parameter-type{case}", sent=sent, command=known.name, types=types)


REFUSALS: tuple[Refusal, ...] = (
    Refusal("format-refused", (), _explain_format),
    Refusal("unknown-command", _NAME_CODES, _explain_unknown),
    Refusal("argument-refused", _TYPE_CODES, _explain_argument),
)
