"""Base classes of all screens, and of screens with several views. Also defines help, palette and prompt."""

from __future__ import annotations

import gc
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, cast

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.command import CommandPalette, DiscoveryHit, Hit, Hits, Provider
from textual.containers import Vertical, VerticalScroll
from textual.content import Content
from textual.dom import DOMNode
from textual.events import ScreenResume
from textual.screen import ModalScreen, Screen
from textual.widget import Widget
from textual.widgets import Input, Static

from bcapscope.messages import Language
from bcapscope.messages.message import has_message
from bcapscope.tui.app import BcapApp, app_of
from bcapscope.tui.reader_language import label
from bcapscope.tui.themes import THEMES
from bcapscope.tui.widgets.bars import KeyBar, TopBar
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.plain_containers import PlainContainer, Switcher
from bcapscope.tui.widgets.text_widgets import InkedText


class HelpScreen(ModalScreen[None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,f1", "dismiss", "shell.close", key_display="esc")
    ]

    def __init__(self, name: str, text: str, keys: Sequence[ScreenCommand]) -> None:
        super().__init__()
        self._title, self._text, self._keys = name, text, keys

    def compose(self) -> ComposeResult:
        with VerticalScroll(id="help") as page:
            page.border_title = Text(label("shell.help.title", name=self._title)).markup
            page.border_subtitle = label("shell.close.hint")
            yield Static(Group(*self._parts()), id="help-text")

    def _parts(self) -> Iterator[RenderableType]:
        inks = app_of(self).text_styles
        for paragraph in self._text.split("\n"):
            yield Text(paragraph)
        yield Text(f"\n{label('shell.keys')}", style=inks["name"])
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")  # Japanese text has no spaces, so a line may break anywhere
        for each in self._keys:
            table.add_row(Text(each.key, inks["number"]), Text(each.name, inks["name"]), Text(each.tip))
        yield table


class ScreenCommand(NamedTuple):
    """An action in the command palette. `key` is the name of the action's key; "" for no key."""

    name: str
    tip: str
    action: str
    node: DOMNode
    key: str = ""


def node_commands(node: DOMNode, app: BcapApp) -> Iterator[ScreenCommand]:
    """Yield one command for each action that has a key in a widget, a screen or the application."""
    for kind in type(node).__mro__:
        for binding in vars(kind).get("BINDINGS", ()):
            if isinstance(binding, Binding) and has_message(binding.description):
                tip = binding.tooltip or f"{binding.description}.tip"
                key = Binding(binding.key.partition(",")[0], "", "", key_display=binding.key_display)
                name, tip = label(binding.description), label(tip) if has_message(tip) else ""
                yield ScreenCommand(name, tip, binding.action, node, app.get_key_display(key))


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
    for entry in app.screen_entries:
        name = label("shell.screen", name=label(entry.name))
        tip = label("shell.screen.tip")
        yield ScreenCommand(name, tip, f"switch_mode('{entry.mode}')", app, entry.key.upper())
    for theme in THEMES:
        name = label("shell.theme", name=label(f"shell.theme.{theme.name}"))
        yield ScreenCommand(name, label("shell.theme.tip"), f"theme('{theme.name}')", app)
    for code, key in (("", "auto"), *((each.value, each.value) for each in Language)):
        name = label("shell.language", name=label(f"shell.language.{key}"))
        yield ScreenCommand(name, label("shell.language.tip"), f"language('{code}')", app)


class ScreenCommandProvider(Provider):
    def _available_commands(self) -> Iterator[tuple[ScreenCommand, partial[Coroutine[Any, Any, bool]]]]:
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


class BaseScreen(Screen[None], PlainContainer):
    """A screen that the user can open; the method `content` yields the screen's widgets.

    `NAME` and `ABOUT` are the message ids of the screen's name and description.
    """

    NAME: ClassVar[str]
    ABOUT: ClassVar[str]
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("f1", "help", "shell.help"),
        Binding("ctrl+p", "palette", "shell.palette"),
        Binding("tab", "app.focus_next", "shell.next", show=False),
        Binding("shift+tab", "app.focus_previous", "shell.previous", show=False),
    ]

    def compose(self) -> ComposeResult:
        # Set the style classes for this terminal width before the first layout. Textual sets them after it.
        classes = [name for width, name in self.HORIZONTAL_BREAKPOINTS or () if width <= self.app.size.width]
        self.set_class(True, *classes[-1:], update=False)
        yield TopBar()
        yield from self.content()
        yield KeyBar()

    def on_mount(self) -> None:
        # After `gc.freeze`, garbage collections skip the widgets, take less time, and so delay keys less.
        self.call_after_refresh(gc.freeze)

    def on_screen_resume(self, event: ScreenResume) -> None:
        event.refresh_styles = False  # each widget already has the right styles, even after a change of theme

    def call_in_screen(self, function: Callable[..., object], *arguments: object) -> None:
        """Call a function in the screen's thread, without waiting. Any thread may call this method."""
        self.call_later(function, *arguments)

    def content(self) -> ComposeResult:
        raise NotImplementedError

    def commands(self) -> Iterator[tuple[str, str, str]]:
        """Yield name, explanation and action of the palette's commands that have no key."""
        yield from ()

    async def action_palette(self) -> None:
        palette = CommandPalette(providers=[ScreenCommandProvider], placeholder=label("shell.palette.hint"))
        await self.app.push_screen(palette)

    async def action_help(self) -> None:
        keys = [command for command in all_commands(self, app_of(self)) if command.key]
        await self.app.push_screen(HelpScreen(label(self.NAME), label(self.ABOUT), keys))

    async def ask(self, title: str, hint: str, value: str = "") -> str | None:
        return await self.app.push_screen_wait(Prompt(title, hint, value))


def view_keys(views: Mapping[str, str], tip: str) -> Iterator[Binding]:
    """Yield a number key for each view of a screen. `tip` is the id of a label that explains the keys."""
    for number, (view, name) in enumerate(views.items(), 1):
        yield Binding(f"{number}", f"view('{view}')", name, show=False, tooltip=tip)


class ViewsScreen(BaseScreen):
    """A screen that shows one of its lists at a time. Number keys and the view bar switch between the lists.

    The content of a subclass must include a `ViewBar`, an `InkedText` with the id ``head`` for column titles,
    and a `Switcher` with one list per view. The id of a list is the name of the view.
    """

    VIEWS: ClassVar[Mapping[str, str]]
    """Label ids by view name. The screen starts with the first view."""

    def __init__(self) -> None:
        super().__init__()
        self.view = next(iter(self.VIEWS))

    @property
    def shown_list(self) -> Lines:
        found = self.query_one(f"#{self.view}")
        assert isinstance(found, Lines)
        return found

    def show_header(self) -> None:
        self.query_one("#head", InkedText).show_text(self.shown_list.header(), layout=False)

    def action_view(self, view: str) -> None:
        self.view = view
        self.query_one(Switcher).current = view
        self.show_view()
        self.set_focus(self.shown_list)
        self.refresh_bindings()
        self.show_state()

    def show_view(self) -> None:
        """Show the widgets of the visible view, and hide those of all other views."""
        raise NotImplementedError

    def show_state(self) -> None:
        """Show the number of rows of each view, and the state of the screen."""
        raise NotImplementedError

    def action_back(self) -> None:
        self.set_focus(self.shown_list)


class Prompt(ModalScreen[str | None]):
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss(None)", "prompt.cancel", key_display="esc")
    ]

    def __init__(self, title: str, hint: str, value: str = "") -> None:
        super().__init__()
        self._question, self._hint, self._value = title, hint, value

    def compose(self) -> ComposeResult:
        with Vertical(id="prompt"):
            yield Static(Text(self._question), id="prompt-title")
            yield Input(self._value, id="prompt-input")
            yield Static(
                Text(f"{self._hint}   ⏎ {label('prompt.accept')}   esc {label('prompt.cancel')}".strip()),
                id="prompt-hint",
            )

    def on_input_submitted(self, event: Input.Submitted) -> None:
        self.dismiss(event.value)
