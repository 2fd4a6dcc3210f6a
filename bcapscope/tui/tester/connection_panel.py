"""The connection panel of the Tester, and the Tester's status line."""

from __future__ import annotations

from dataclasses import dataclass

from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.suggester import SuggestFromList
from textual.widgets import Button, Input

from bcapscope.client.controller_target import split_host_port
from bcapscope.live.controller.arming_state import ArmingState
from bcapscope.live.controller.halt_connection import HaltState, HaltUpdate
from bcapscope.live.controller.reply_monitor import ReplyMonitor
from bcapscope.live.controller.session_updates import ConnectStep, ConnectStepUpdate, SessionStatus
from bcapscope.protocol.number_parsing import parse_integer
from bcapscope.protocol.slave_mode.modes import pose_type_of_mode
from bcapscope.render.escape import printable
from bcapscope.tui.app import app_of
from bcapscope.tui.controller_access.call_history import reason_text
from bcapscope.tui.controller_access.option_field import read_option_field
from bcapscope.tui.ink import INK
from bcapscope.tui.reader_language import full_error_text, label
from bcapscope.tui.tester.form_widgets import Caption, FormButton, TickBox
from bcapscope.tui.widgets.text_widgets import InkedText

_STEP_MARKS = {None: "◌", True: "●", False: "✗"}


@dataclass
class ConnectWanted(Message):
    host: str
    port: int
    tcp: bool
    option: str


class ConnectionPanel(Vertical):
    """The fields of a connection; Enter in any of these fields connects."""

    def __init__(self, host: str, port: int, tcp: bool, option: str) -> None:
        super().__init__()
        self._initial_fields = (host, port, tcp, option)
        self._steps: dict[ConnectStep, ConnectStepUpdate] = {}
        self._problem = ""
        self._is_address_pending = False
        self._is_connect_pending = False

    def compose(self) -> ComposeResult:
        host, port, tcp, option = self._initial_fields
        with Horizontal(classes="row"):
            yield Caption("tester.ip")
            known = SuggestFromList(app_of(self).settings.hosts, case_sensitive=False)
            yield Input(host, suggester=known, id="host")
            yield TickBox("UDP", not tcp, id="udp")
            yield Input(str(port), id="port", type="integer", max_length=5)
            yield Caption("tester.option")
            yield Input(option, placeholder="Timeout=300", id="option")
        with Horizontal(classes="row"):
            yield FormButton("tester.connect", "primary", id="connect")
            yield FormButton("tester.disconnect", id="disconnect", disabled=True)
            yield InkedText(id="steps")
        yield InkedText(id="found")

    def on_mount(self) -> None:
        self._update_texts()

    def wait_for_address(self) -> None:
        """Postpone connecting until `fill_address` fills in the address."""
        self._is_address_pending, self._is_connect_pending = True, False
        self._problem = ""
        self._update_texts()

    def fill_address(self, host: str, port: int) -> None:
        self.query_one("#host", Input).value = host
        self.query_one("#port", Input).value = str(port)
        self._is_address_pending = False
        self._update_texts()
        if self._is_connect_pending:
            self.request_connect()

    def cancel_connect(self) -> None:
        """Prevent `fill_address` from starting a postponed connection."""
        self._is_connect_pending = False

    def wanted_connection(self) -> ConnectWanted | str:
        """Return the connection that the fields describe, or a text that says what is wrong with them."""
        host, port = split_host_port(self.query_one("#host", Input).value.strip())
        port = port or self.query_one("#port", Input).value.strip()  # "host:5007" takes precedence
        tcp = not self.query_one("#udp", TickBox).value
        option = self.query_one("#option", Input).value
        if not host:
            return label("tester.host.missing")
        number = parse_integer(port, 1, 65535)
        if number is None:
            return label("tester.port.wrong")
        try:
            read_option_field(option, host, number, tcp)
        except ValueError as error:
            return full_error_text(error)
        return ConnectWanted(host, number, tcp, option)

    def clear_steps(self) -> None:
        self._steps = {}
        self._problem = ""
        self._update_texts()

    def show_step(self, step_update: ConnectStepUpdate) -> None:
        self._steps[step_update.step] = step_update
        self._update_texts()

    def show_problem(self, reason: str) -> None:
        self._is_address_pending = False
        self._problem = reason
        self._update_texts()

    def show_status(self, status: SessionStatus) -> None:
        self.query_one("#disconnect", Button).disabled = not status.is_connected
        for name in ("#host", "#port", "#option", "#udp", "#connect"):
            self.query_one(name).disabled = status.is_connected
        if not status.is_connected and all(each.done is not False for each in self._steps.values()):
            self._steps = {}
            self._update_texts()

    def set_connecting(self, connecting: bool) -> None:
        """While connecting, disable Connect, and enable Disconnect, which cancels the connection attempt."""
        self.query_one("#disconnect", Button).disabled = not connecting
        self.query_one("#connect", Button).disabled = connecting

    def _update_texts(self) -> None:
        news = reversed(self._steps.values())
        last = next((each for each in news if each.result or each.done is False), None)
        text = f"{INK.bad}{printable(self._problem)}{INK.reset}" if self._problem else ""
        if not text and last is not None:
            color = INK.bad if last.done is False else INK.dim
            text = f"{color}{printable(reason_text(last.result))}{INK.reset}"
        if not text:
            hint = "tester.simulator.starting" if self._is_address_pending else "tester.connect.hint"
            text = f"{INK.dim}{label(hint)}{INK.reset}"
        self.query_one("#steps", InkedText).show_text(" ".join(map(self._step_text, ConnectStep)))
        self.query_one("#found", InkedText).show_text(text)

    def _step_text(self, step: ConnectStep) -> str:
        name, news = label(f"tester.step.{step}"), self._steps.get(step)
        if news is None:
            return f"{INK.dim}○ {name}{INK.reset}"
        color = {None: INK.number, True: INK.good, False: INK.bad}[news.done]
        return f"{color}{_STEP_MARKS[news.done]} {name}{INK.reset}"

    @on(Input.Changed)
    def _check_fields(self) -> None:
        wanted = "" if self._is_address_pending else self.wanted_connection()
        self._problem = wanted if isinstance(wanted, str) else ""
        self._update_texts()

    @on(Button.Pressed, "#connect")
    @on(Input.Submitted)
    def request_connect(self) -> None:
        if self._is_address_pending:
            self._is_connect_pending = True
            return
        wanted = self.wanted_connection()
        if isinstance(wanted, str):
            self._problem = wanted
            self._update_texts()
        else:
            self.query_one("#host", Input).value = wanted.host
            self.query_one("#port", Input).value = str(wanted.port)
            self.post_message(wanted)


_MAX_HOST_LENGTH = 24
_SECOND = 1_000_000_000
_LONG_SILENCE = 3 * _SECOND
_HALT_STYLES = {HaltState.READY: "good", HaltState.HALTED: "bad", HaltState.OPENING: "dim"}


def status_pieces(
    status: SessionStatus, arming: ArmingState, now: int, halt: HaltUpdate, reply_monitor: ReplyMonitor
) -> list[tuple[str, str]]:
    """Return the texts in the status line, each with the name of its style."""
    if status.target is None:
        return [(f" {label('tester.status.none')} ", "dim")]
    name = label("tester.status.simulator")
    if not status.identity.is_simulator:
        name = printable(status.target.host)[:_MAX_HOST_LENGTH]
    age = reply_monitor.silence(now)
    if reply_monitor.is_reply_overdue(now):
        text = label("tester.status.silent", seconds=age // _SECOND)
        pieces = [(f" ◌ {name} ", "bad"), (f"{text} ", "bad")]
    # no reply is expected now, for example in slave mode, so silence proves nothing
    elif age >= _LONG_SILENCE:
        text = label("tester.status.age", seconds=age // _SECOND)
        pieces = [(f" ● {name} ", ""), (f"{text} ", "dim")]
    else:
        text = f"{status.round_trip / 1e6:.1f} ms " if status.round_trip else ""
        pieces = [(f" ● {name} ", "good"), (text, "dim")]
    if status.slave_mode:
        kind = pose_type_of_mode(status.slave_mode) or ""
        text = label("tester.status.slave", mode=f"{status.slave_mode:03X}", kind=kind)
        pieces.append((f" {text} ", "problem"))
    pieces.append(_arming_piece(arming, now))
    pieces.append((f" F12 {label(f'tester.halt.{halt.state}')} ", _HALT_STYLES.get(halt.state, "bad")))
    return pieces


def _arming_piece(arming: ArmingState, now: int) -> tuple[str, str]:
    if not arming.is_required:
        return f" {label('tester.status.free')} ", "good"
    if not arming.is_armed(now):
        return f" {label('tester.status.safe')} ", "good"
    seconds = arming.remaining(now) // _SECOND
    return f" {label('tester.status.armed')} {seconds // 60}:{seconds % 60:02d} ", "bad"


def arming_facts(status: SessionStatus) -> list[str]:
    """Describe the controller and its robot to the user who must decide whether to arm."""
    identity, robot = status.identity, status.robot
    unknown = label("tester.fact.unknown")
    return [
        label("tester.fact.peer", peer=printable(str(status.target))),
        label("tester.fact.version", version=printable(identity.version) or unknown),
        label("tester.fact.robot", robot=printable(robot.label) if robot else unknown),
        label(
            "tester.fact.type",
            name=printable(identity.type_name) or unknown,
            number=printable(identity.type_number) or unknown,
        ),
    ]
