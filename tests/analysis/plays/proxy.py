"""What a proxy did to the traffic that it recorded."""

from __future__ import annotations

from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import Play, Story
from tests.samples.calls import US, Datagrams
from tests.samples.legs import PROXY_FAR, PROXY_NEAR, TwoPlaces


def _through_a_proxy(note: str, **lost: str) -> Play:
    def play(story: Story) -> None:
        near, far = story.client(), story.client(50002)
        near.network = Datagrams(server=PROXY_NEAR)
        far.network = Datagrams(client=PROXY_FAR)
        places = TwoPlaces(near.network, far.network, 200 * US, note)
        places.lost = {int(number.removeprefix("call")): what for number, what in lost.items()}
        places.poll(12)

    return play


SCENES = (
    Scene(
        "injected-fault",
        _through_a_proxy("drop: dropped", call5="request"),
        (21,),
        ("the proxy applied its rule drop to CurJnt 6", ": dropped."),
        _through_a_proxy("", call5="request"),
    ),
    Scene(
        "retried",
        _through_a_proxy("drop: dropped", call5="request"),
        (21, 22, 25),
        ("A request was lost", "The proxy received 1 frame of this call that it did not forward"),
        _through_a_proxy("drop: dropped"),
        cause="injected-fault",
    ),
    Scene(
        "reply-lost",
        _through_a_proxy("burst: dropped in a burst", call5="reply"),
        (21, 23, 24, 27),
        ("your client retried", "The proxy received 1 frame of this call that it did not forward"),
        _through_a_proxy("", call5="request"),
        cause="injected-fault",
    ),
    Scene(
        "retried",
        _through_a_proxy("", call5="request"),
        (21, 22, 25),
        ("The proxy received 1 frame of this call that it did not forward",),
        _through_a_proxy(""),
    ),
    Scene(
        "injected-fault",
        _through_a_proxy("dropped by hand", call5="reply"),
        (23,),
        ("the proxy recorded this note on CurJnt 6", ": dropped by hand."),
        _through_a_proxy("", call5="reply"),
    ),
)
