"""The lines above the lists of a proxy's screen."""

from __future__ import annotations

import pytest

from bcapscope.messages import Language
from bcapscope.tui.proxy_display import summary_lines
from bcapscope.tui.reader_language import set_language
from tests.tui.proxy_panel.proxy_figures import figures


@pytest.mark.parametrize(
    ("language", "warning"),
    [(Language.ENGLISH, "script stopped, motion refused"), (Language.JAPANESE, "スクリプト停止・動作拒否")],
)
def test_a_script_that_is_off_is_shown(language: Language, warning: str) -> None:
    def shown(scripts: str | None) -> str:
        return "\n".join(summary_lines(figures(scripts=scripts)))

    set_language(language)
    try:
        assert warning in shown("off: it took longer than 100 ms for request; mine.py line 7 in request")
        assert warning not in shown("on")
        assert warning not in shown(None)
    finally:
        set_language(Language.ENGLISH)
