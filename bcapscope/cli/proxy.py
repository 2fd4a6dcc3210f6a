"""``bcapscope proxy``: watch, record and disturb live traffic."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from bcapscope.capture.rotating_recording import RotationLimits, is_named_pipe, parse_rotation
from bcapscope.cli.common import options
from bcapscope.cli.common.attended import announce_ready, attended_option, publish_option
from bcapscope.cli.common.exit_codes import ExitCode, exit_with, usage_error_on
from bcapscope.cli.common.output_files import check_output_path
from bcapscope.cli.common.proxy_rule_options import RuleOptions, rule_options
from bcapscope.cli.proxy_ctl import command as ctl
from bcapscope.live.cpu_wakefulness import low_latency_problem
from bcapscope.live.end_signals import end_signal_socket
from bcapscope.live.proxy_options import ProxyOptions, TrafficFormat, ViewOptions, WatcherSubscriber
from bcapscope.live.proxy_supervisor import ProxySupervisor
from bcapscope.live.server_runner import reachability
from bcapscope.live.standard_streams import print_stderr
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.places import Clauses, Listing
from bcapscope.proxy.control_socket import ControlError
from bcapscope.proxy.listener_spec import ListenerSpec, ListenerSpecError, parse_listener_specs
from bcapscope.proxy.script_protocol import ScriptError
from bcapscope.proxy.sockets import ProxyListenError, UnreachableError
from bcapscope.render.escape import printable
from bcapscope.render.timestamp import TimeFormat
from bcapscope.traffic.filter.compiler import FilterError
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.observation import Endpoint


@click.group(invoke_without_command=True)
@click.option(
    "--listen",
    metavar="HOST:PORT",
    multiple=True,
    help="Listen on this address. With the prefix udp: or tcp:, listen on this transport only. Port 0 "
    "chooses a free port. For several controllers, repeat --listen and --to together.",
)
@click.option("--to", metavar="HOST:PORT", multiple=True, help="Forward to this controller.")
@click.option(
    "--transport",
    type=click.Choice(["udp", "tcp", "both"]),
    default="both",
    help="Listen on this transport if --listen has no prefix.",
)
@click.option(
    "--allow",
    metavar="ADDRESS",
    multiple=True,
    help="Accept only clients at this address or in this network; may be repeated. Default: all.",
)
@options.record_option(
    "Record the traffic of both legs to a new capture, or to a named pipe that a program reads."
)
@click.option(
    "--ring",
    metavar="RING",
    callback=options.parsed_by(parse_rotation),
    help="Record to a ring of files, such as 10x100MB, 24x1h or 24x1h,500MB. A new file replaces the oldest.",
)
@click.option(
    "--forget",
    metavar="SECONDS",
    type=options.NumberRange(1),
    default=600.0,
    help="Forget a UDP client that was silent for this many seconds.",
)
@click.option(
    "--low-latency",
    is_flag=True,
    help="Keep the processors of this machine out of deep sleep while there is much traffic. This needs "
    "write access to /dev/cpu_dma_latency (Linux) and costs electricity.",
)
@click.option("--calls", is_flag=True, help="Show calls, like `calls`. Default: frames, like `decode`.")
@click.option(
    "--tree",
    "form",
    flag_value=TrafficFormat.TREE,
    type=TrafficFormat,
    help="Show every field of each frame. With --calls, show the frames of each call.",
)
@click.option(
    "--json",
    "form",
    flag_value=TrafficFormat.JSON,
    type=TrafficFormat,
    help="Print one JSON object per frame. With --calls, print one JSON object per call.",
)
@click.option(
    "-f",
    "--filter",
    "wanted",
    metavar="EXPRESSION",
    help="Show only frames that match this filter. With --calls, show only calls that match. "
    "`bcapscope fields` lists the fields.",
)
@options.time_format
@options.color
@options.language
@click.option("-q", "--quiet", is_flag=True, help="Do not show the traffic.")
@rule_options
@attended_option
@publish_option
@click.pass_context
def command(
    context: click.Context,
    /,
    *,
    record: Path | None,
    ring: RotationLimits | None,
    forget: float,
    low_latency: bool,
    calls: bool,
    form: TrafficFormat | None,
    wanted: str | None,
    clock: str,
    color: str,
    words: MessageFormatter,
    quiet: bool,
    rules: RuleOptions,
    attended: bool,
    open_subscriber: Callable[[], WatcherSubscriber] | None,
    **addresses: Any,
) -> None:
    """Forward traffic between b-CAP clients and controllers, and watch, record or disturb this traffic.

    By default, the proxy forwards bytes immediately and unchanged. A separate process records and shows
    the traffic.

    Ctrl-C ends the open sessions, closes the recording and prints a summary. A second Ctrl-C ends the proxy
    immediately. In a shell script, end a background proxy with SIGTERM, as in kill $!. The background jobs of
    a shell script ignore Ctrl-C (SIGINT).

    Each message goes through four parts of the proxy in this order: scripts (--script), held messages
    (--intercept), faults (--fault, --rules), and the guard (--read-only, --block, --allow-command). With
    `--control ADDRESS`, you can change the rules of a running proxy: `bcapscope proxy ctl ADDRESS`. When
    the proxy ends, it sends all held replies and drops all held requests except stops.

    All scripts run in one separate process. Messages that a script can change wait for the script; stops
    never wait. All scripts are switched off if one of them exceeds --script-timeout, or if their process
    ends.

    Exit codes: 0: you ended the proxy; 2: invalid command line; 4: the proxy cannot listen on an address, or
    cannot use a script; 6: the recording cannot be written, or is incomplete because the disk was full or the
    recorder stopped; 9: the name of a controller is unknown.
    """
    if context.invoked_subcommand is not None:
        return
    if low_latency and (problem := low_latency_problem()) is not None:
        print_stderr(words("low-latency.no-effect", reason=problem))
    if ring is not None and record is None:
        raise click.UsageError("--ring needs --record FILE.pcapng")
    shown = None if quiet else RecordKind.CALL if calls else RecordKind.FRAME
    view = ViewOptions(shown, form or TrafficFormat.LINE, wanted or "", TimeFormat(clock), words.language)
    with usage_error_on(ListenerSpecError):
        listeners = parse_listener_specs(**addresses)
    _check_filter(context, view)
    if record is not None and ring is None and not is_named_pipe(record):
        check_output_path(record)
    proxy_options = ProxyOptions(record, ring, view, color, open_subscriber)
    _ProxyRun(listeners, rules, round(forget * 1e9), low_latency, attended, words).run(proxy_options)


command.add_command(ctl)


def _check_filter(context: click.Context, view: ViewOptions) -> None:
    try:
        view.compiled_filter()
    except FilterError as error:
        raise click.BadParameter(f"\n{error}", context, param_hint="--filter") from None


@dataclass(frozen=True, slots=True)
class _ProxyRun:
    listeners: Sequence[ListenerSpec]
    rules: RuleOptions
    forget_ns: int
    low_latency: bool
    attended: bool
    words: MessageFormatter

    def run(self, proxy_options: ProxyOptions) -> None:
        with ExitStack() as opened:
            try:
                proxy, greet = self._open(opened, proxy_options)
            except (ProxyListenError, ControlError, ScriptError) as error:
                exit_with(printable(self.words.text(error.message)), ExitCode.UNREADABLE)
            except UnreachableError as error:
                exit_with(self.words.text(error.message), ExitCode.UNANSWERED)
            proxy.run(greet)
        if proxy.is_recording_incomplete:
            sys.exit(ExitCode.UNWRITABLE)

    def _open(
        self, opened: ExitStack, proxy_options: ProxyOptions
    ) -> tuple[ProxySupervisor, Callable[[], None]]:
        """Start the proxy. Return the proxy, and a function that reports where the proxy listens."""
        listening: list[str] = []
        scripts = self.rules.start_scripts(opened)
        policy = self.rules.build_rules(scripts)
        ends = opened.enter_context(end_signal_socket())
        supervisor = ProxySupervisor(proxy_options, ends, policy, low_latency=self.low_latency)
        proxy = opened.enter_context(closing(supervisor))
        for line in self.rules.summary():
            print_stderr(self.words.text(line))
        record = proxy_options.record if proxy_options.ring is None else None
        recording = None if record is None else str(record if is_named_pipe(record) else record.resolve())
        state = {"recording": recording, "listening": listening}
        control = None if policy is None else self.rules.attach_rules(policy, proxy.relay, state)
        if control is not None:
            opened.callback(control.close)
            print_stderr(self.words("rules.control", address=control.address))
        addresses = [proxy.listen(listener, self.forget_ns) for listener in self.listeners]
        if scripts is None or policy is None:
            proxy.start_watcher()
        else:
            scripts.attach(policy, proxy.relay, proxy.must_end_now)
            proxy.start_watcher(scripts.load)
        pairs = list(zip(self.listeners, addresses, strict=True))
        listening += [f"{address} > {each.to}" for each, address in pairs]
        greetings = [_greeting(*pair) for pair in pairs]

        def greet() -> None:
            if self.attended:
                print_stderr("\n".join(map(self.words.text, greetings)))
                announce_ready(listening, control.address if control else "")
                proxy.end_with_parent()
                return
            # this process must not print here, because the watcher process redraws the terminal's last line
            for greeting in greetings:
                proxy.relay.notify(greeting)

        return proxy, greet


def _greeting(listener: ListenerSpec, address: Endpoint) -> Message:
    transports = Listing(tuple(each.upper() for each in listener.transports))
    clauses = [
        Message("proxy.route", address=str(address), transports=transports, controller=str(listener.to)),
        reachability(address.host),
    ]
    if listener.allow:
        clauses.append(Message("proxy.only", clients=", ".join(map(str, listener.allow))))
    return Message("list.clauses", items=Clauses(tuple(clauses)))
