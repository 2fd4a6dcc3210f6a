"""Handles: used wrongly, and never given back."""

from __future__ import annotations

from bcapscope.analysis.client import Client, Clients, result_of, text_argument
from bcapscope.analysis.finding import Severity
from bcapscope.analysis.rules.refusal import Refusal, Why, fixed, refusal
from bcapscope.analysis.rules.rule import SECOND, Kind, Report, Rule, Watcher
from bcapscope.analysis.speech import Speech, called, shown
from bcapscope.protocol.functions import FUNCTIONS, ObjectClass
from bcapscope.protocol.hresult import E_HANDLE, E_MAX_OBJECT
from bcapscope.traffic.exchange import Exchange
from bcapscope.traffic.handles import handle_of
from bcapscope.traffic.observation import Conversation
from bcapscope.traffic.question import Question

_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"

LEAK = Rule(
    "handle-leak",
    Severity.WARNING,
    "a client gets the same object again and again without releasing it",
    "Get the object once and keep its handle, or release it after use: a client may hold 1000.",
    _SERVER,
)
BAD_HANDLE = Rule(
    "bad-handle",
    Severity.ERROR,
    "a call is refused for its handle",
    "Get a new handle after each release, disconnect or new connection; handles belong to the connection "
    "that got them and to one class of objects.",
    _SERVER,
    ("unclean-quit",),
    600 * SECOND,
)
TOO_MANY = Rule(
    "too-many-objects",
    Severity.ERROR,
    "a call is refused since the client holds too many objects",
    "Release objects after use.",
    _SERVER,
    ("handle-leak",),
    24 * 3600 * SECOND,
)

_LEAKS_FROM = 20
_MOST_NAMES = 4096


class _Tally:
    """Handles of one object that are open now, and at most."""

    def __init__(self) -> None:
        self.open = self.most = 0


class Objects(Watcher):
    """Counts what is opened and not released."""

    rules = (LEAK,)

    def __init__(self, report: Report, clients: Clients) -> None:
        super().__init__(report, clients)
        self._tallies: dict[tuple[Conversation, ObjectClass, str], _Tally] = {}

    def heeds(self, question: Question, kind: Kind) -> bool:
        function = FUNCTIONS.get(question.function_id)
        return (
            kind is not Kind.REFUSED and function is not None and bool(function.creates or function.releases)
        )

    def call(self, call: Exchange, client: Client) -> None:
        function, thing = FUNCTIONS[call.question.function_id], client.thing
        if function.creates is ObjectClass.SERVICE or function.releases is ObjectClass.SERVICE:
            self._forget(call.conversation)
        elif function.creates is not None and isinstance(result_of(call), int):
            name = text_argument(call, 0 if function.creates is ObjectClass.CONTROLLER else 1)
            self._opened(call, function.creates, name)
        elif function.releases is not None and thing is not None and _is_over(call):
            tally = self._tallies.get((call.conversation, thing.kind, thing.name))
            if tally is not None:
                tally.open -= 1

    def gone(self, client: Client, ended: int) -> None:
        self._forget(client.conversation)

    def _opened(self, call: Exchange, kind: ObjectClass, name: str) -> None:
        key = call.conversation, kind, name
        tally = self._tallies.get(key)
        if tally is None:
            if len(self._tallies) >= _MOST_NAMES:
                del self._tallies[self._least_telling()]
            tally = self._tallies[key] = _Tally()
        tally.open += 1
        if tally.open <= tally.most:
            return
        tally.most = tally.open
        if tally.most == _LEAKS_FROM:
            self._leaks(call, kind, name, tally)

    def _least_telling(self) -> tuple[Conversation, ObjectClass, str]:
        """Return an object that is not open twice, the first one; the first of all where there is none."""
        single = (key for key, tally in self._tallies.items() if tally.open <= 1)
        return next(single, next(iter(self._tallies)))

    def _leaks(self, call: Exchange, kind: ObjectClass, name: str, tally: _Tally) -> None:
        def say(speech: Speech) -> str:
            who = speech.client(call.conversation)
            return f"{who} came to hold {tally.most} handles of the {kind} '{shown(name)}' at once"

        self.tell(LEAK, call, say, key=f"{kind} {name}")

    def _forget(self, conversation: Conversation) -> None:
        for key in [key for key in self._tallies if key[0] is conversation]:
            del self._tallies[key]


def _is_over(call: Exchange) -> bool:
    """Tell whether a release was answered, or may have been."""
    return call.reply is not None or call.let_go


def _bad_handle(call: Exchange, client: Client, clients: Clients) -> Why | None:
    function, handle = FUNCTIONS.get(call.question.function_id), handle_of(call.request.item)
    if function is None or handle is None:
        return None
    released = client.released.get((function.owner, handle))
    if released is not None:
        return Why(
            lambda speech: (
                f"handle {handle} was released by {called(released)} at {speech.at(released.request.time)}"
            ),
            before=released,
        )
    opened = client.opened.get(handle)
    if opened is not None and opened.kind is not function.owner:
        return fixed(
            f"handle {handle} is that of the {opened.kind} '{shown(opened.name)}', not of a {function.owner}"
        )
    whose = next((other for other in clients.others(client) if handle in other.opened), None)
    if opened is None and whose is not None:
        owner = whose.conversation
        return Why(
            lambda speech: (
                f"handle {handle} was given to {speech.client(owner)}, and handles belong to their connection"
            )
        )
    if opened is None and client.seen_from_start:
        return fixed(f"handle {handle} was never given to this client, as far as was seen")
    return fixed(f"handle {handle} is not valid now")


REFUSALS: tuple[Refusal, ...] = (
    refusal(BAD_HANDLE, (E_HANDLE,), _bad_handle),
    refusal(TOO_MANY, (E_MAX_OBJECT,)),
)
