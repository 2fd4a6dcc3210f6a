"""What ``bcapscope tui`` shows of commands that it starts, or finds: a proxy, a simulator."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bcapscope.cli.exits import Exit
from bcapscope.cli.files import check_free
from bcapscope.cli.output import narrate, require_terminal
from bcapscope.cli.proxyrules import RuleWishes
from bcapscope.render.escape import printable

if TYPE_CHECKING:
    from bcapscope.proxy.control_answers import Figures
    from bcapscope.tui.child import Child
    from bcapscope.tui.screens.proxy import ProxyScreen
    from bcapscope.tui.traffic.feed import Feed

_NEAR_LEG = "clients of "
"""How the interfaces begin that a proxy's recording has for the clients' side."""


@dataclass(frozen=True, slots=True)
class ProxyWishes:
    """The proxy that is to be shown.

    Attributes:
        address: of the control socket of one that runs; "" for one of our own.
        listen: where ours listens.
        to: and where that leads.
        record: where ours keeps what passes; None for nowhere.
        rules: of ours.
    """

    address: str
    listen: tuple[str, ...]
    to: tuple[str, ...]
    record: Path | None
    rules: RuleWishes


def show_proxy(wishes: ProxyWishes) -> None:
    """Show a proxy, one that runs or one of our own."""
    own = wishes.listen or wishes.to or wishes.record or wishes.rules.typed or wishes.rules.control
    if not wishes.address:
        _show_own(wishes)
    elif own:
        raise click.UsageError(f"the proxy on {wishes.address} has its own --listen, --to and rules")
    else:
        _show_running(wishes.address)


def _show_running(address: str) -> None:
    from bcapscope.tui.traffic.feed import Feed
    from bcapscope.tui.words import say

    figures = _figures(address)
    if figures.recording is None:
        _run(None, _screen(address, figures, None, note=say("proxy.unrecorded")))
        return
    feed = Feed(path=figures.recording, follow=True, ports=figures.ports, leg=_NEAR_LEG)
    try:
        _run(feed, _screen(address, figures, feed))
    finally:
        feed.close()


def _show_own(wishes: ProxyWishes) -> None:
    from bcapscope.proxy.spec import SpecError, parse_listeners

    try:
        parse_listeners(wishes.listen, wishes.to, "both", ())
    except SpecError as error:
        raise click.UsageError(str(error)) from None
    if wishes.record is not None:
        check_free(wishes.record)
    from bcapscope.tui.traffic.feed import Feed
    from bcapscope.tui.traffic.folder import Folder

    with Folder() as folder:
        record = wishes.record or folder.path / "proxy.pcapng"
        control = wishes.rules.control or _control_in(folder.path)
        words = [word for each in wishes.listen for word in ("--listen", each)]
        words += [word for each in wishes.to for word in ("--to", each)]
        words += ["--record", str(record), "--control", control, "--quiet", *wishes.rules.typed]
        with _child("proxy", *words) as child:
            figures = _figures(child.control)
            feed = Feed(path=str(record), follow=True, ports=figures.ports, leg=_NEAR_LEG)
            try:
                _run(feed, _screen(child.control, figures, feed, child))
            finally:
                feed.close()


def show_simulator(port: int, words: Sequence[str]) -> None:
    """Show what a simulator and its clients say to each other.

    Args:
        port: where it listens, on loopback.
        words: further options of ``bcapscope sim``.
    """
    from bcapscope.tui.app import Scope, Spot
    from bcapscope.tui.screens.simulated import Simulated
    from bcapscope.tui.traffic.feed import Feed
    from bcapscope.tui.traffic.folder import Folder

    with Folder() as folder:
        record = folder.path / "simulator.pcapng"
        with _child("sim", "--port", f"{port}", "--record", str(record), "--quiet", *words) as child:
            (address,) = child.listening
            feed = Feed(path=str(record), follow=True, ports=(int(address.rpartition(":")[2]),))
            try:
                require_terminal()
                Scope([Spot("traffic", "f3", "traffic", lambda: Simulated(feed, address, child))]).show()
            finally:
                feed.close()


def _screen(
    address: str, figures: Figures, feed: Feed | None, child: Child | None = None, note: str = ""
) -> ProxyScreen:
    from bcapscope.tui.screens.proxy import ProxyScreen

    return ProxyScreen(address, ", ".join(figures.listening), feed, child, note)


def _run(feed: Feed | None, screen: ProxyScreen) -> None:
    from bcapscope.tui.app import Scope, Spot
    from bcapscope.tui.screens.traffic import TrafficScreen

    spots = [Spot("proxy", "f2", "proxy", lambda: screen)]
    if feed is not None:
        spots.append(Spot("traffic", "f3", "traffic", lambda: TrafficScreen(feed, screen.way)))
    require_terminal()
    Scope(spots).show()


def _figures(address: str) -> Figures:
    """Ask a proxy how it stands; end the program if there is none."""
    import msgspec

    from bcapscope.errors import BcapError
    from bcapscope.proxy.control_answers import figures_of
    from bcapscope.proxy.control_client import ControlClient

    client = ControlClient(address)
    try:
        return figures_of(client.ask({"do": "stats"}))
    except BcapError as error:
        narrate(printable(str(error)))
    except msgspec.ValidationError:
        narrate(f"the program on {printable(address)} is not a bcapscope proxy of this version")
    finally:
        client.close()
    sys.exit(Exit.UNREADABLE)


@contextmanager
def _child(*words: str) -> Iterator[Child]:
    """Run a command for the length of a block; what it says at its end is for the user."""
    from bcapscope.tui.child import Child, ChildError

    try:
        child = Child(*words)
    except ChildError as error:
        narrate(printable(str(error)))
        sys.exit(error.code)
    try:
        yield child
    finally:
        said = child.end()
        with suppress(OSError):  # the terminal may be closed
            for line in said:
                narrate(printable(line))


def _control_in(folder: Path) -> str:
    """Choose where the proxy is told what to do: where nobody else may, if the system has that."""
    import socket

    path = str(folder / "control")
    longest = 100  # bytes, of the path of a socket: 103 on macOS, 107 on Linux
    if not hasattr(socket, "AF_UNIX"):
        return "127.0.0.1:0"
    if len(os.fsencode(path)) <= longest:
        return path
    return os.path.join(tempfile.gettempdir(), f"bcapscope-{os.getpid()}-{folder.name[-8:]}")
