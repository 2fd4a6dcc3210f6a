"""A screen of several lists, of which one is seen at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

from textual import on
from textual.binding import Binding

from bcapscope.tui.screens.base_screen import BaseScreen
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.plain_containers import Switcher
from bcapscope.tui.widgets.view_bar import ViewBar


def view_keys(views: Mapping[str, str], tip: str) -> Iterator[Binding]:
    """Give each view of a screen its number as a key; `tip` is the key of what is said of that."""
    for number, (view, name) in enumerate(views.items(), 1):
        yield Binding(f"{number}", f"view('{view}')", name, show=False, tooltip=tip)


class ViewsScreen(BaseScreen):
    """Shows one of its lists; number keys and the bar lead from one to another.

    The content of a subclass has the bar that `make_view_bar` makes, and a `Switcher` with a `Lines` for each
    of
    `VIEWS`, whose id is the view.

    Attributes:
        VIEWS: names of the views for the program, each with the key of its name for people, the first of them
            seen first.
        view: the one that is seen.
    """

    VIEWS: ClassVar[Mapping[str, str]]

    def __init__(self) -> None:
        super().__init__()
        self.view = next(iter(self.VIEWS))

    def make_view_bar(self) -> ViewBar:
        """Make the bar that names the views."""
        return ViewBar(tuple(self.VIEWS.items()), id="views")

    @property
    def shown_list(self) -> Lines:
        """The list that is seen."""
        found = self.query_one(f"#{self.view}")
        assert isinstance(found, Lines)
        return found

    @on(ViewBar.ViewWanted)
    def _view_wanted(self, message: ViewBar.ViewWanted) -> None:
        self.action_view(message.view)

    def action_view(self, view: str) -> None:
        """Show another view."""
        self.view = view
        self.query_one(Switcher).current = view
        self.show_view()
        self.set_focus(self.shown_list)
        self.refresh_bindings()
        self.show_state()

    def show_view(self) -> None:
        """Show what belongs to the view besides its list, and nothing else."""
        raise NotImplementedError

    def show_state(self) -> None:
        """Show how much is in each view, and all else that is true of the screen at this moment."""
        raise NotImplementedError

    def action_back(self) -> None:
        """Go to the list."""
        self.set_focus(self.shown_list)
