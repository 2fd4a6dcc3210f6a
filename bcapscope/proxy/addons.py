"""Add-ons: classes in a user's script that see each message, and may change, drop or answer it.

A script is a Python file. For each class in the file, the proxy creates one object if the class has at least
one of the methods below. Then it calls these methods. The constructor of the class must need no arguments.

    request(message)      a request arrived from a client
    reply(message)        a reply arrived from the controller
    settled(call)         a call is complete: answered, refused or given up
    connected(client)     a client sent its first message
    gone(client)          a client is gone
    done()                the proxy ends

Add-ons run in a process of their own. The proxy holds each message until the add-ons have decided about it.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from bcapscope.faults.quantities import HresultQuantity
from bcapscope.faults.wire_message import WireMessage
from bcapscope.messages import Message
from bcapscope.protocol.codec.frame import Frame
from bcapscope.protocol.codec.frame_template import FrameTemplates
from bcapscope.protocol.tables.function_table import function_name
from bcapscope.proxy.script_protocol import (
    MAX_SENTENCES,
    ClientConnected,
    ClientGone,
    ExpireCalls,
    FinishScripts,
    MessageShown,
    ScriptAnswer,
    ScriptError,
    ScriptOrder,
    wire_sentence,
)
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.handle_tracker import TrackedObject
from bcapscope.traffic.observation import (
    SERVER_PARTICIPANT,
    Conversation,
    Direction,
    Endpoint,
    Flow,
    Transport,
)
from bcapscope.traffic.pipeline import Pipeline, PipelineSubscriber

HOOKS = ("request", "reply", "settled", "connected", "gone", "done")

SLOW_HOOK_NS = 2_000_000
"""A hook that takes longer than this time in ns counts as slow. The controller must answer a set point within
2 ms (DENSO Wave 2009, How to use the Slave mode).
"""


class AddonClient(NamedTuple):
    """A client, as add-ons see it. No two clients have the same `number`."""

    number: int
    address: Endpoint
    controller: Endpoint
    transport: Transport


class PassingMessage:
    """A message in transit. Hooks replace the message by assigning other bytes to `data`. `call_kind` is the
    function and command that the message calls or answers; None if unknown.
    """

    def __init__(self, client: AddonClient, message: WireMessage) -> None:
        self.client = client
        self.data = message.data
        self.dropped = False
        self._answers: list[int] = []
        self.call_kind = message.call_kind
        self._frames = message.frames

    @property
    def frame(self) -> Frame | None:
        """The frame as received; None for bytes that are not a frame."""
        return self._frames[0] if self._frames else None

    @property
    def function(self) -> str | None:
        return None if self.call_kind is None else function_name(self.call_kind.function_id)

    @property
    def command(self) -> str | None:
        """Command of an `..._Execute` function; None for other functions."""
        return None if self.call_kind is None else self.call_kind.command

    @property
    def values(self) -> list[Any]:
        return [argument.variant.value for argument in self.frame.arguments] if self.frame else []

    @property
    def answers(self) -> tuple[int, ...]:
        """Result codes that the proxy sends to the client instead of the controller's reply."""
        return tuple(self._answers)

    def drop(self) -> None:
        self.dropped = True

    def answer(self, hresult: int | str) -> None:
        """Drop the request, and answer the client with the result code of this name or number. If there is no
        such code, raise a `ValueError`.
        """
        self._answers.append(HresultQuantity.read(hresult))
        self.dropped = True


class AddonRunner(PipelineSubscriber):
    """Executes the orders of the proxy: calls the hooks of all add-ons, and collects their answers. If a hook
    raises several errors, the runner reports only the first error, and continues to call the hook.
    """

    def __init__(self, addons: Sequence[object], clock: Callable[[], int] = time.perf_counter_ns) -> None:
        """Prepare to call the hooks of `addons`. `clock`, in ns, measures how long a hook takes."""
        self._clock = clock
        self._errors = 0
        self._notices: list[Message] = []
        self._reported: set[tuple[int, str, str]] = set()
        self._hooks: dict[str, list[tuple[object, Callable[..., object]]]] = {
            name: [(addon, getattr(addon, name)) for addon in addons if callable(getattr(addon, name, None))]
            for name in HOOKS
        }
        self._pipeline = Pipeline(self) if self._hooks["settled"] else None
        self._clients: dict[int, tuple[AddonClient, Conversation]] = {}
        self._recent_requests = RecentRequests()
        self._templates = FrameTemplates()
        self._messages = 0

    @property
    def hooks(self) -> frozenset[str]:
        return frozenset(name for name, found in self._hooks.items() if found)

    def execute(self, order: ScriptOrder) -> ScriptAnswer:
        """Carry out an order of the proxy, and return the add-ons' answer. Raise a `KeyError` if the order
        names an unknown client.
        """
        pipeline = self._pipeline
        match order:
            case MessageShown():
                return self._show_message(order)
            case ClientConnected():
                self._add_client(order)
            case ClientGone():
                client, conversation = self._clients.pop(order.client)
                self._recent_requests.close_conversation(conversation)
                if pipeline is not None:
                    pipeline.close_conversation(conversation)
                self._call_all("gone", client)
            case ExpireCalls():
                if pipeline is not None:
                    pipeline.expire(order.time)
            case FinishScripts():
                if pipeline is not None:
                    pipeline.finish()
                self._call_all("done")
        return self._answer()

    def _add_client(self, order: ClientConnected) -> None:
        end, controller = (Endpoint(*each) for each in order.ends)
        transport = Transport(order.transport)
        client = AddonClient(order.client, end, controller, transport)
        self._clients[order.client] = client, Conversation(end, controller, transport, SERVER_PARTICIPANT)
        self._call_all("connected", client)

    def _show_message(self, order: MessageShown) -> ScriptAnswer:
        client, conversation = self._clients[order.client]
        self._messages += 1
        flow = Flow(conversation, Direction.REQUEST if order.up else Direction.RESPONSE)
        number, templates = self._messages, self._templates
        message = WireMessage(number, flow, order.data, order.now, order.time, templates=templates)
        message.annotate(self._recent_requests)
        passing = self._run_message_hooks(client, message)
        return self._answer(
            data=None if passing.data == order.data else bytes(passing.data),
            dropped=bool(passing.dropped),
            results=tuple(map(int, passing.answers)),
        )

    def _answer(self, **verdict: Any) -> ScriptAnswer:
        notices = tuple(map(wire_sentence, self._notices[:MAX_SENTENCES]))
        self._notices.clear()
        has_open_calls = self._pipeline is not None and self._pipeline.has_open_calls
        return ScriptAnswer(notices, self._errors, has_open_calls, **verdict)

    def _run_message_hooks(self, client: AddonClient, message: WireMessage) -> PassingMessage:
        """Pass a message through the add-ons. Each add-on sees the changes of the previous add-ons."""
        passing = PassingMessage(client, message)
        name = "request" if message.flow.direction is Direction.REQUEST else "reply"
        for addon, hook in self._hooks[name]:
            self._call(addon, name, hook, passing)
            if passing.dropped:
                break
        if not isinstance(passing.data, bytes):
            if self._is_new(self, name, "data"):
                self._notices.append(Message("addon.data", hook=name))
            passing.data = message.data
        if self._pipeline is not None:
            for annotated in message.annotated_frames:
                self._pipeline.add(annotated.observation)
        return passing

    def on_call(self, call: Call, target: TrackedObject | None) -> None:
        self._call_all("settled", call)

    def _call_all(self, name: str, *arguments: object) -> None:
        for addon, hook in self._hooks[name]:
            self._call(addon, name, hook, *arguments)

    def _call(self, addon: object, name: str, hook: Callable[..., object], *arguments: object) -> None:
        hook_name = f"{type(addon).__name__}.{name}"
        began = self._clock()
        try:
            hook(*arguments)
        except BaseException as error:  # catch even SystemExit, because the process must continue
            # call `_where` only for a new error, because `_where` takes long to find the line of an error
            if self._is_new(addon, name, "error"):
                self._notices.append(Message("addon.error", hook=hook_name, error=_where(error)))
        took = self._clock() - began
        if took > SLOW_HOOK_NS and self._is_new(addon, name, "slow"):
            self._notices.append(Message("addon.slow", hook=hook_name, time=f"{took / 1e6:.1f} ms"))

    def _is_new(self, addon: object, name: str, kind: str) -> bool:
        """Count a problem of a hook as an error, unless the hook is only slow. Return whether this kind of
        problem is new for the hook, so that the user must see the problem.
        """
        self._errors += kind != "slow"
        key = (id(addon), name, kind)
        is_new = key not in self._reported
        self._reported.add(key)
        return is_new


def load_addons(path: str) -> list[object]:
    """Run a script, and return one object of each class that has a hook. If the script cannot be read, fails,
    or contains no add-on, raise a `ScriptError`.
    """
    module = _load_module(path)
    kinds = [
        kind
        for name, kind in vars(module).items()
        if isinstance(kind, type) and kind.__module__ == module.__name__ and not name.startswith("_")
    ]
    kinds = [kind for kind in kinds if any(callable(getattr(kind, hook, None)) for hook in HOOKS)]
    if not kinds:
        hooks = ", ".join(HOOKS[:-1])
        raise ScriptError(Message("script.no-class", path=path, hooks=hooks, last=HOOKS[-1]))
    for kind in kinds:
        for hook in HOOKS:
            if inspect.iscoroutinefunction(getattr(kind, hook, None)):
                raise ScriptError(Message("script.async", path=path, hook=f"{kind.__name__}.{hook}"))
    try:
        return [kind() for kind in kinds]
    except BaseException as error:
        raise ScriptError(Message("script.failed", path=path, error=_where(error))) from error


def _load_module(path: str) -> ModuleType:
    name = f"bcapscope_script_{Path(path).stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ScriptError(Message("script.no-python", path=path))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # needed by dataclasses, which look up their module in sys.modules
    try:
        spec.loader.exec_module(module)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename == spec.origin:
            reason = error.strerror or str(error)
            raise ScriptError(Message("script.unreadable", path=path, reason=reason)) from error
        raise ScriptError(Message("script.failed", path=path, error=_where(error))) from error
    return module


def _where(error: BaseException) -> str:
    """Return the error of a script and the line where it occurred, as one line of text."""
    if isinstance(error, SyntaxError):
        return f"{error.msg} (line {error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    spot = f" ({Path(frames[-1].filename).name} line {frames[-1].lineno})" if frames else ""
    text = "".join(traceback.format_exception_only(error)).splitlines()[0]
    return f"{text}{spot}"
