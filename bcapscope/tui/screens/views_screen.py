"""A screen with several lists, one of which is visible."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

from textual.binding import Binding

from bcapscope.tui.screens.base_screen import BaseScreen
from bcapscope.tui.widgets.bars import ViewBar
from bcapscope.tui.widgets.lines import Lines
from bcapscope.tui.widgets.plain_containers import Switcher


def view_keys(views: Mapping[str, str], tip: str) -> Iterator[Binding]:
    """Yield a number key for each view of a screen; `tip` is the label key of the explanation."""
    for number, (view, name) in enumerate(views.items(), 1):
        yield Binding(f"{number}", f"view('{view}')", name, show=False, tooltip=tip)


class ViewsScreen(BaseScreen):
    """A screen that shows one of its lists; number keys and the view bar switch between them.

    A subclass yields the bar from `make_view_bar` and a `Switcher` as part of its content. The switcher holds
    a `Lines` widget for each of `VIEWS`, with the name of the view as the widget's id.

    Attributes:
        VIEWS: Label key of each view, by the view's name. The screen starts with the first view.
    """

    VIEWS: ClassVar[Mapping[str, str]]

    def __init__(self) -> None:
        super().__init__()
        self.view = next(iter(self.VIEWS))

    def make_view_bar(self) -> ViewBar:
        return ViewBar(tuple(self.VIEWS.items()), id="views")

    @property
    def shown_list(self) -> Lines:
        found = self.query_one(f"#{self.view}")
        assert isinstance(found, Lines)
        return found

    def action_view(self, view: str) -> None:
        self.view = view
        self.query_one(Switcher).current = view
        self.show_view()
        self.set_focus(self.shown_list)
        self.refresh_bindings()
        self.show_state()

    def show_view(self) -> None:
        """Show the widgets that belong to the visible view, and hide those of other views."""
        raise NotImplementedError

    def show_state(self) -> None:
        """Show the counts of all views and the present state of the screen in the view bar."""
        raise NotImplementedError

    def action_back(self) -> None:
        self.set_focus(self.shown_list)
