"""Keyboard navigation in the Tester: between the connection panel, the tabs with forms, and the views."""

from __future__ import annotations

from collections.abc import Iterator

from textual.widget import Widget

from bcapscope.tui.reader_language import label
from bcapscope.tui.screens.base_screen import BaseScreen
from bcapscope.tui.tester.form_tabs import TABS, FormTabs
from bcapscope.tui.tester.form_widgets import ChoiceRow
from bcapscope.tui.tester.packet_pane import VIEWS, PacketPane

_PART_SELECTOR = "#left .box, #function, #raw, #right"
_FOCUS_SELECTOR = "Input, HexView, Lines, Button"
_SKIP_SELECTOR = "#slave-mode, #clear, #history-filter"
"""CSS selector of widgets that the navigation skips, because they precede the main widget of an area."""


class TesterNavigation(BaseScreen):
    """Navigation in a screen that contains `FormTabs` and a `PacketPane`. A subclass binds the keys."""

    def commands(self) -> Iterator[tuple[str, str, str]]:
        """Yield palette commands for tabs and views, because reaching one by keys takes several keys."""
        for kind, names in (("tab", TABS), ("view", VIEWS)):
            for name in names:
                title = label(f"tester.{kind}", name=label(f"tester.{kind}.{name}"))
                yield title, label(f"tester.{kind}.tip"), f"{kind}('{name}')"

    def action_part(self, by: int) -> None:
        parts = list(self.query(_PART_SELECTOR))
        here = next((at for at, part in enumerate(parts) if part.has_focus_within), -1 if by > 0 else 0)
        for step in range(1, len(parts) + 1):
            if self._focus_first_in(parts[(here + by * step) % len(parts)]):
                return

    def action_next_tab(self) -> None:
        here = self.query_one("#tabs", ChoiceRow).chosen
        self.action_tab(TABS[(TABS.index(here) + 1) % len(TABS)])

    def action_next_view(self) -> None:
        here = self.query_one("#view", ChoiceRow).chosen
        self.action_view(VIEWS[(VIEWS.index(here) + 1) % len(VIEWS)])

    def action_tab(self, name: str) -> None:
        self.query_one(FormTabs).show_tab(name)
        self.call_after_refresh(self._focus_first_in, self.query_one("#panels"))

    def action_view(self, name: str) -> None:
        self.query_one(PacketPane).show_view(name)
        self.call_after_refresh(self._focus_first_in, self.query_one(f"#{name}"))

    def _focus_first_in(self, part: Widget) -> bool:
        """Focus the first usable widget in an area of the screen; return whether there is one."""
        among = (part, *part.query(_FOCUS_SELECTOR).exclude(_SKIP_SELECTOR))
        shown = (each for each in among if all(node.display for node in each.ancestors_with_self))
        found = next((each for each in shown if each.focusable), None)
        if found is not None:
            found.focus()
        return found is not None
