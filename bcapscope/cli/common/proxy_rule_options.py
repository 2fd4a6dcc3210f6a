"""Options of ``bcapscope proxy`` that define rules."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from bcapscope.cli.common import options
from bcapscope.faults.quantities import DurationQuantity, FrameCondition
from bcapscope.messages import Message
from bcapscope.messages.places import Count

# This module imports most other modules inside functions, so that `bcapscope tui` starts fast.
if TYPE_CHECKING:
    from bcapscope.faults.fault_kinds import AnyFault
    from bcapscope.proxy.control_socket import ControlServer
    from bcapscope.proxy.relay import Relay
    from bcapscope.proxy.request_guard import GuardTarget, RequestGuard
    from bcapscope.proxy.rule_policy import RulePolicy
    from bcapscope.proxy.script_process import ScriptProcess

_SHORTEST_SCRIPT_LIMIT, _LONGEST_SCRIPT_LIMIT = 1_000_000, 10_000_000_000
"""Shortest and longest time limit for the scripts, in ns. Waking the scripts' process takes less than 1 ms.
After more than 10 s, a held motion would be dangerous: its client may have given up long before.
"""


@dataclass(frozen=True, slots=True)
class RuleOptions:
    """The values of the rule options; None selects the proxy's default. `faults` begins with the faults of
    the command line. `command_line` contains the options that the user typed, except --control. `tui --proxy`
    starts a proxy in another process with these options.
    """

    seed: int
    faults: tuple[AnyFault, ...] = ()
    read_only: bool = False
    block: tuple[GuardTarget, ...] = ()
    allow_command: tuple[GuardTarget, ...] = ()
    intercept: FrameCondition | None = None
    hold_ns: int | None = None
    scripts: tuple[str, ...] = ()
    script_limit_ns: int | None = None
    script_memory_mb: int | None = None
    control: str | None = None
    command_line: tuple[str, ...] = ()

    def start_scripts(self, exit_stack: ExitStack) -> ScriptProcess | None:
        """Start the scripts' process; None if there are no scripts. Raises ScriptError."""
        if not self.scripts:
            return None
        from bcapscope.proxy.script_process import DEFAULT_MEMORY_MB, ScriptProcess

        scripts = ScriptProcess(self.scripts, self.script_memory_mb or DEFAULT_MEMORY_MB)
        return exit_stack.enter_context(closing(scripts))

    def build_rules(self, scripts: ScriptProcess | None = None) -> RulePolicy | None:
        """Create the rules; None if the options define none. The delay `after` of each fault starts now."""
        guard = self._make_guard()
        if not (self.faults or guard or self.intercept or self.scripts or self.control):
            return None
        from bcapscope.faults.fault_injector import FaultInjector
        from bcapscope.proxy.intercept import Intercept
        from bcapscope.proxy.rule_policy import RulePolicy
        from bcapscope.proxy.script_queue import TIME_LIMIT_NS, ScriptQueue

        now = time.monotonic_ns()
        epoch = time.time_ns() - now
        injector = FaultInjector(self.faults, seed=self.seed, now=now, epoch=epoch)
        queue = None
        if scripts is not None:
            queue = ScriptQueue(scripts.names, scripts, self.script_limit_ns or TIME_LIMIT_NS)
        return RulePolicy(injector, guard, Intercept(self.intercept, self._hold_limit_ns), queue, epoch=epoch)

    def attach_rules(
        self, rules: RulePolicy, relay: Relay, state: Mapping[str, object]
    ) -> ControlServer | None:
        """Report messages of rules and scripts through `relay.notify`. With --control, return the control
        server, or raise ControlError. Programs that connect to the control server can also read `state`.
        """
        from bcapscope.proxy.control_api import ControlApi
        from bcapscope.proxy.control_messages import RelayDelays
        from bcapscope.proxy.control_socket import ControlServer
        from bcapscope.proxy.ring_buffer import RelayCounter

        rules.notify = relay.notify
        if rules.scripts is not None:
            rules.scripts.notify = relay.notify
        if not self.control:
            return None

        def figures() -> dict[str, object]:
            counts = {count.name.lower(): relay.counts[count] for count in RelayCounter}
            delays = RelayDelays(*relay.ring.figures)
            return {"clients_now": len(relay.sessions), **counts, "delays_ns": delays, **state}

        def upstream(number: int) -> str:
            session = relay.sessions.get(number)
            return "" if session is None else session.upstream_state

        return ControlServer(self.control, ControlApi(rules, figures, upstream), relay)

    def summary(self) -> list[Message]:
        lines = []
        if self.faults:
            lines.append(Message("rules.faults", count=Count(len(self.faults), "fault"), seed=self.seed))
        if self._has_guard:
            lines.append(Message("rules.guard"))
        if self.intercept is not None:
            limit = f"{self._hold_limit_ns / 1e9:g} s"
            lines.append(Message("rules.intercept", limit=limit))
        return lines

    @property
    def _has_guard(self) -> bool:
        return self.read_only or bool(self.block or self.allow_command)

    def _make_guard(self) -> RequestGuard | None:
        if not self._has_guard:
            return None
        from bcapscope.proxy.request_guard import RequestGuard

        return RequestGuard(self.read_only or bool(self.allow_command), self.block, self.allow_command)

    @property
    def _hold_limit_ns(self) -> int:
        from bcapscope.proxy.intercept import HOLD_TIME_NS

        return HOLD_TIME_NS if self.hold_ns is None else self.hold_ns


_TYPED = f"{__name__}.typed"
"""Key in `click.Context.meta` for the rule options that the user typed."""


def _make_rule_options(
    rule_files: tuple[tuple[AnyFault, ...], ...], faults: tuple[AnyFault, ...], **given: Any
) -> RuleOptions:
    faults = (*faults, *chain.from_iterable(rule_files))
    names = [fault.name for fault in faults if fault.name]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise click.UsageError(f"two faults have the name {twice}: rename one")
    typed = [*click.get_current_context().meta.get(_TYPED, ()), *["--read-only"] * given["read_only"]]
    seed = given.pop("seed")
    return RuleOptions(
        random.randrange(1_000_000) if seed is None else seed, faults, command_line=tuple(typed), **given
    )


def _parsing_callback(read: Callable[[Any], Any]) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """Return a click callback that parses an option, and keeps the text that the user typed."""
    parse = options.parsed_by(read)

    def convert(context: click.Context, parameter: click.Parameter, value: Any) -> Any:
        if context.get_parameter_source(parameter.name or "") is not ParameterSource.DEFAULT:
            values = value if isinstance(value, tuple) else (value,)
            typed = context.meta.setdefault(_TYPED, [])
            typed += [word for each in values for word in (parameter.opts[0], str(each))]
        return parse(context, parameter, value)

    return convert


def _fault(text: str) -> AnyFault:
    from bcapscope.faults.fault_notation import read_fault

    return read_fault(text)


def _target(text: str) -> GuardTarget:
    from bcapscope.proxy.request_guard import read_target

    return read_target(text)


def _script_limit(text: str) -> int:
    limit = DurationQuantity.read(text)
    if not _SHORTEST_SCRIPT_LIMIT <= limit <= _LONGEST_SCRIPT_LIMIT:
        raise ValueError(f"{text} is not a time from 1ms to 10s")
    return limit


def _rule_file(path: str) -> tuple[AnyFault, ...]:
    from bcapscope.faults.document import LONGEST_DOCUMENT, DocumentError, RuleFile, read_document

    try:
        with Path(path).open(encoding="utf-8") as file:
            text = file.read(LONGEST_DOCUMENT + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    try:
        return read_document(text, RuleFile).faults
    except DocumentError as error:
        raise ValueError(f"{path}: {error}") from error


def _fault_notation() -> list[str]:
    from bcapscope.faults import fault_notation

    return (fault_notation.__doc__ or "").strip().splitlines()


_OPTIONS = (
    click.option(
        "--fault",
        "faults",
        metavar="FAULT",
        multiple=True,
        callback=_parsing_callback(_fault),
        help="Inject this fault: 'loss=5%', 'delay=3ms±1ms if command == slvMove', 'drop reply try 1'. May "
        "be repeated. --help-faults explains the notation.",
    ),
    click.option(
        "--rules",
        "rule_files",
        metavar="FILE.yaml",
        multiple=True,
        callback=_parsing_callback(_rule_file),
        help="Read faults from this file, in the notation of --help-faults; may be repeated.",
    ),
    click.option(
        "--seed",
        type=options.IntegerRange(0, options.LARGEST_SEED),
        callback=_parsing_callback(int),
        help="Random seed (default: a new seed each time). The same seed and traffic give the same faults.",
    ),
    click.option(
        "--read-only",
        is_flag=True,
        help="Refuse unknown requests, and requests that energise or move the robot or change its state. "
        "The client gets E_ACCESSDENIED. The proxy always forwards stops: Robot_Halt, Robot_Hold, Task_Stop, "
        "Command_Cancel, HandStop, TwofgStop, slvChangeMode 0, releases, Controller_Disconnect and "
        "Service_Stop. The proxy also forwards Controller_Connect, because clients need the controller's "
        "handle to read anything.",
    ),
    click.option(
        "--block",
        metavar="NAME",
        multiple=True,
        callback=_parsing_callback(_target),
        help="Refuse this function, command or FUNCTION:COMMAND with E_ACCESSDENIED; may be repeated.",
    ),
    click.option(
        "--allow-command",
        metavar="NAME",
        multiple=True,
        callback=_parsing_callback(_target),
        help="Refuse requests as --read-only does, but allow this function or command; may be repeated.",
    ),
    click.option(
        "--intercept",
        metavar="EXPRESSION",
        callback=_parsing_callback(FrameCondition.read),
        help="Hold messages that match this filter until `proxy ctl` releases, edits or drops them. "
        "`bcapscope fields` lists the fields.",
    ),
    click.option(
        "--hold",
        "hold_ns",
        metavar="TIME",
        callback=_parsing_callback(DurationQuantity.read),
        help="Hold a message at most this long (default: 60s), then send it unchanged. The proxy drops a "
        "held request if the client closed its connection, made another call, or on UDP did not retry for "
        "5 s.",
    ),
    click.option(
        "--script",
        "scripts",
        metavar="FILE.py",
        multiple=True,
        type=click.Path(exists=True, dir_okay=False),
        callback=_parsing_callback(str),
        help="Run this script on the traffic; may be repeated. The classes of the file have one or more "
        "of the methods request(message), reply(message), settled(call), connected(client), gone(client) "
        "and done(). Scripts run in a separate process, with your rights.",
    ),
    click.option(
        "--script-timeout",
        "script_limit_ns",
        metavar="TIME",
        callback=_parsing_callback(_script_limit),
        help="Give the scripts this much time for one message, 1ms to 10s (default: 100ms). If a script "
        "takes longer, all scripts are switched off. The proxy then refuses motion with "
        "E_ACCESSDENIED, and forwards everything else, including stops, unchanged.",
    ),
    click.option(
        "--script-memory",
        "script_memory_mb",
        metavar="MEGABYTES",
        type=options.IntegerRange(64, 65536),
        callback=_parsing_callback(int),
        help="Let the scripts allocate this many megabytes (default: 512).",
    ),
    click.option(
        "--control",
        metavar="PATH|127.0.0.1:PORT",
        help="Listen for `bcapscope proxy ctl` on this socket. Anyone who can open this socket "
        "can do everything with the robot that you can do.",
    ),
    options.text_option("--help-faults", _fault_notation, "Explain the notation of faults, and exit."),
)

_NAMES = ("rule_files", *(each.name for each in fields(RuleOptions)))

rule_options = options.bundled("rules", _make_rule_options, _OPTIONS, _NAMES)
"""Adds the rule options. The command gets the argument `rules` of type `RuleOptions`."""
