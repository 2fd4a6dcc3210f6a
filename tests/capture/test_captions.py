"""Captions tell who sent a packet."""

import pytest

from bcapscope.capture.hex_text import LONGEST_CAPTION, caption_direction, shorten_caption
from bcapscope.traffic.observation import Direction

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE


@pytest.mark.parametrize(
    ("caption", "direction"),
    [
        ("TX", REQUEST),
        ("tx1:", REQUEST),
        ("RX", RESPONSE),
        ("TX(Client->Server):", REQUEST),
        ("Packet TX(Client->Server) Retry #1", REQUEST),
        ("Packet RX(Server->Client) #2", RESPONSE),
        ("SendData", REQUEST),
        ("Receive_Data", RESPONSE),
        ("Client \u2192server:", REQUEST),
        ("Server => PC", RESPONSE),
        ("from the controller to the client", RESPONSE),
        ("Sent by the PC", REQUEST),
        ("the controller's reply", RESPONSE),
        ("\u9001\u4fe1\u30c7\u30fc\u30bf", REQUEST),
        ("\u53d7\u4fe1:", RESPONSE),
        ("reply to the request", None),
        ("client and server", None),
        ("context, extra, Sendai, xrx", None),
        ("", None),
    ],
)
def test_who_sent_it(caption: str, direction: Direction | None) -> None:
    assert caption_direction(caption) is direction


def test_the_last_sentence_of_a_paragraph_decides() -> None:
    assert caption_direction("First TX was sent. This is the RX packet:") is RESPONSE
    assert caption_direction("This was sent. Then, after a while:") is REQUEST


@pytest.mark.parametrize(
    ("words", "short"),
    [("- SendData:", "SendData"), ("  ## RX = ", "RX"), ("", ""), ("One. " * 40 + "The last", "The last")],
)
def test_captions_are_kept_short(words: str, short: str) -> None:
    assert shorten_caption(words) == short


def test_a_long_sentence_keeps_its_end() -> None:
    assert shorten_caption("x" * 500 + "y") == "x" * (LONGEST_CAPTION - 1) + "y"
