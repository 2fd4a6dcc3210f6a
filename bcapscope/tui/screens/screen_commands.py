"""The command palette: finds every action of a screen by its name."""

from __future__ import annotations

from collections.abc import Coroutine, Iterator
from functools import partial
from typing import Any, NamedTuple, cast

from textual.binding import Binding
from textual.command import DiscoveryHit, Hit, Hits, Provider
from textual.content import Content
from textual.dom import DOMNode
from textual.widget import Widget

from bcapscope.messages import Language
from bcapscope.messages.message import has_message
from bcapscope.tui.app import BcapApp
from bcapscope.tui.reader_language import label
from bcapscope.tui.themes import THEMES


class ScreenCommand(NamedTuple):
    """An action in the palette; `key` is its key as the documentation writes it, or ""."""

    name: str
    tip: str
    action: str
    node: DOMNode
    key: str = ""


def node_commands(node: DOMNode, app: BcapApp) -> Iterator[ScreenCommand]:
    """Yield the commands for one node's key bindings, each action once."""
    for kind in type(node).__mro__:
        for binding in vars(kind).get("BINDINGS", ()):
            if isinstance(binding, Binding) and has_message(binding.description):
                tip = binding.tooltip or f"{binding.description}.tip"
                key = app.get_key_display(
                    Binding(binding.key.partition(",")[0], "", "", key_display=binding.key_display)
                )
                yield ScreenCommand(
                    label(binding.description),
                    label(tip) if has_message(tip) else "",
                    binding.action,
                    node,
                    key,
                )


def all_commands(screen: DOMNode, app: BcapApp) -> Iterator[ScreenCommand]:
    known: set[tuple[str, str]] = set()
    widgets = [widget for widget in screen.query(Widget) if widget.display]
    for node in (screen, *widgets, app):
        for command in node_commands(node, app):
            if (command.name, command.action) not in known:
                known.add((command.name, command.action))
                yield command
    for name, tip, action in getattr(screen, "commands", lambda: ())():
        yield ScreenCommand(name, tip, action, screen)
    yield from _app_commands(app)


def _app_commands(app: BcapApp) -> Iterator[ScreenCommand]:
    for spot in app.screen_entries:
        name = label("shell.screen", name=label(spot.name))
        yield ScreenCommand(
            name, label("shell.screen.tip"), f"switch_mode('{spot.mode}')", app, spot.key.upper()
        )
    for theme in THEMES:
        name = label("shell.theme", name=label(f"shell.theme.{theme.name}"))
        yield ScreenCommand(name, label("shell.theme.tip"), f"theme('{theme.name}')", app)
    for code, key in (("", "auto"), *((each.value, each.value) for each in Language)):
        name = label("shell.language", name=label(f"shell.language.{key}"))
        yield ScreenCommand(name, label("shell.language.tip"), f"language('{code}')", app)


class ScreenCommandProvider(Provider):
    def _available_commands(self) -> Iterator[tuple[ScreenCommand, partial[Coroutine[Any, Any, bool]]]]:
        """Yield the commands that can run now, each with the function that runs the command."""
        for command in all_commands(self.screen, cast(BcapApp, self.app)):
            if command.node.check_action(command.action.partition("(")[0], ()) is not False:
                yield command, partial(self.app.run_action, command.action, command.node)

    async def discover(self) -> Hits:
        for command, run in self._available_commands():
            text = f"{command.name}  ({command.key})" if command.key else command.name
            yield DiscoveryHit(Content(text), run, command.name, command.tip or None)

    async def search(self, query: str) -> Hits:
        matcher = self.matcher(query)
        for command, run in self._available_commands():
            score = matcher.match(command.name)
            if score > 0:
                yield Hit(score, matcher.highlight(command.name), run, command.name, command.tip or None)
