"""What became of packets, in one line."""

from __future__ import annotations

from collections import Counter

from bcapscope.capture.capture_counts import CaptureCounts
from bcapscope.render.capture_counts_text import capture_counts_text


def test_only_what_was_met_is_told() -> None:
    assert capture_counts_text(CaptureCounts(packets=1, items=1)) == "1 frame in 1 packet"


def test_everything_that_can_be_met() -> None:
    counts = CaptureCounts(
        packets=100,
        items=50,
        malformed=2,
        gaps=1,
        missing=7,
        not_ip=1,
        broken=3,
        not_bcap=4,
        cut=1,
        fragments_lost=2,
        contradictions=1,
        unknown_links=Counter({147: 5}),
    )
    assert capture_counts_text(counts) == (
        "47 frames in 100 packets; 2 malformed; 1 gap, 7 bytes missing; 5 packets of other protocols; "
        "1 packet cut short by the capture; 3 packets with damaged headers; "
        "2 datagrams with missing fragments; "
        "1 TCP segment sent again with different bytes; "
        "5 packets of link type 147, which bcapscope does not know"
    )
