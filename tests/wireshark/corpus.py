"""Examples of hypothesis strategies as a list, for programs that take many at once."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st


def corpus(source: st.SearchStrategy[bytes], count: int) -> list[bytes]:
    """Draw `count` examples, the same in every run."""
    drawn: list[bytes] = []

    @settings(
        max_examples=count,
        phases=[Phase.generate],
        database=None,
        derandomize=True,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(source)
    def draw(data: bytes) -> None:
        drawn.append(data)

    draw()
    return drawn
