"""Rules about handles that a client uses wrongly or never releases."""

from __future__ import annotations

from bcapscope.analysis.call_arguments import result_of
from bcapscope.analysis.client_state import ClientState
from bcapscope.analysis.finding_places import call_place, client_place
from bcapscope.analysis.rules.rule_checker import (
    CallHealth,
    Refusal,
    RefusalReason,
    RuleChecker,
    failure_case,
)
from bcapscope.messages import Message
from bcapscope.messages.places import Count, Moment, WireText
from bcapscope.protocol.tables.function_table import FUNCTIONS, ObjectClass
from bcapscope.protocol.tables.hresult import E_HANDLE, E_MAX_OBJECT
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import CallKind
from bcapscope.traffic.handle_tracker import handle_of, requested_name
from bcapscope.traffic.observation import Conversation

_LEAK_AT = 20
_MAX_NAMES = 4096


class _HandleTally:
    def __init__(self) -> None:
        self.open = self.most = 0
        self.leak_call: Call | None = None


class ObjectChecker(RuleChecker):
    def set_up(self) -> None:
        self._tallies: dict[tuple[Conversation, ObjectClass, str], _HandleTally] = {}

    def wants_call(self, call_kind: CallKind, health: CallHealth) -> bool:
        function = FUNCTIONS.get(call_kind.function_id)
        return (
            health is not CallHealth.REFUSED
            and function is not None
            and bool(function.creates or function.releases)
        )

    def on_call(self, call: Call, client: ClientState) -> None:
        function, target = FUNCTIONS[call.kind.function_id], client.target_object
        if function.creates is ObjectClass.SERVICE or function.releases is ObjectClass.SERVICE:
            self._drop_conversation(call.conversation)
        elif function.creates is not None and isinstance(result_of(call), int):
            self._count_opened(call, function.creates, requested_name(call, function))
        elif function.releases is not None and target is not None and _may_be_released(call):
            tally = self._tallies.get((call.conversation, target.kind, target.name))
            if tally is not None:
                tally.open -= 1

    def drop_client(self, client: ClientState) -> None:
        self._drop_conversation(client.conversation)

    def _count_opened(self, call: Call, kind: ObjectClass, name: str) -> None:
        key = call.conversation, kind, name
        tally = self._tallies.get(key)
        if tally is None:
            if len(self._tallies) >= _MAX_NAMES:
                del self._tallies[self._least_relevant()]
            tally = self._tallies[key] = _HandleTally()
        tally.open += 1
        if tally.open <= tally.most:
            return
        tally.most = tally.open
        if tally.most >= _LEAK_AT:
            is_update = tally.leak_call is not None
            tally.leak_call = tally.leak_call or call
            self._report_leak(tally.leak_call, kind, name, tally.most, is_update)

    def _report_leak(self, call: Call, kind: ObjectClass, name: str, handles: int, is_update: bool) -> None:
        fact = Message(
            "finding.handle-leak",
            client=client_place(call.conversation),
            handles=Count(handles, "handle"),
            kind=kind.value,
            name=WireText(name),
        )
        self.report_call("handle-leak", call, fact, group_key=f"{kind} {name}", is_update=is_update)

    def _least_relevant(self) -> tuple[Conversation, ObjectClass, str]:
        """Return the key of the oldest object with at most one open handle, or else of the oldest object."""
        single = (key for key, tally in self._tallies.items() if tally.open <= 1)
        return next(single, next(iter(self._tallies)))

    def _drop_conversation(self, conversation: Conversation) -> None:
        for key in [key for key in self._tallies if key[0] is conversation]:
            del self._tallies[key]


def _may_be_released(call: Call) -> bool:
    return call.reply is not None or call.evicted or call.reply_not_captured


def _explain_bad_handle(call: Call, client: ClientState) -> RefusalReason | None:
    function, handle = FUNCTIONS.get(call.kind.function_id), handle_of(call.request.item)
    if function is None or handle is None:
        return None
    released = client.released_by.get((function.owner, handle))
    if released is not None:
        place, at = call_place(released), Moment(released.request.time)
        reason = Message("reason.handle-released", handle=handle, call=place, at=at)
        return RefusalReason(reason, evidence_call=released)
    opened = client.opened_objects.get(handle)
    if opened is not None and opened.object_class is not function.owner:
        return RefusalReason(
            Message(
                "reason.handle-of-other-class",
                handle=handle,
                kind=opened.object_class.value,
                name=WireText(opened.name),
                wanted=function.owner.value,
            )
        )
    failed = client.failed_openings.get(function.owner)
    if opened is None and failed is not None:
        place, at = call_place(failed), Moment(failed.request.time)
        id = f"reason.handle-not-opened.{failure_case(failed)}"
        reason = Message(id, handle=handle, call=place, at=at)
        return RefusalReason(reason, explaining_calls=(failed.number,), evidence_call=failed)
    owner = next((other for other in client.other_clients() if handle in other.opened_objects), None)
    if opened is None and owner is not None:
        other = client_place(owner.conversation)
        return RefusalReason(Message("reason.handle-of-other-client", handle=handle, other=other))
    case = "never-given" if opened is None and client.session_start_seen else "invalid"
    return RefusalReason(Message(f"reason.handle-{case}", handle=handle))


REFUSALS: tuple[Refusal, ...] = (
    Refusal("bad-handle", (E_HANDLE,), _explain_bad_handle),
    Refusal("too-many-objects", (E_MAX_OBJECT,)),
)
