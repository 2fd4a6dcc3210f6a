"""Beginning and end of a session, and calls that take long."""

from __future__ import annotations

from bcapscope.protocol.codec.variant import EMPTY
from tests.analysis.plays.scene import Scene
from tests.analysis.scenes import CONTROLLER, ROBOT, Play, Story, good
from tests.samples.calls import MS, START, i4, i4s, text
from tests.samples.tcp import Connection

_INVALID, _NAME_USED, _BUSY, _EXECUTING = 0x80070057, 0x80000205, 0x809100AA, 0x900


def _begins_with(function: str, code: int) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        if function == "Controller_GetRobot":
            client.call(0, function, CONTROLLER, text("Arm"), text(""), code=code)
        else:
            client.call(0, function, text(""), code=code)

    return play


def _connects(provider: str, code: int, name: str = "") -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.call(0, "Service_Start", text(""))
        names = map(text, (name, provider, "localhost", ""))
        client.call(5, "Controller_Connect", *names, code=code, result=None if code else CONTROLLER)

    return play


def _connects_twice(code: int) -> Play:
    def play(story: Story) -> None:
        names = tuple(map(text, ("cell", "CaoProv.DENSO.VRC", "localhost", "")))
        for port, at in ((50001, 0), (50002, 3000)):
            client = story.client(port)
            client.call(at, "Service_Start", text(",WDT=400"))
            result = None if code and at else CONTROLLER
            client.call(at + 5, "Controller_Connect", *names, code=code if at else 0, result=result)
        story.client(50003).call(20000, "Service_Start", text(""))

    return play


def _vanishes(others_until: float, closes: bool = False) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        client.open()
        if closes:
            client.close(40)
        other = story.client(50002, host="192.168.0.11")
        other.open(100)
        other.close(others_until)

    return play


def _calls_seldom(every: float, calls: int) -> Play:
    """A client that calls every so many ms, and 20 s after its last call another one that goes."""

    def play(story: Story) -> None:
        client = story.client()
        client.open()
        for number in range(1, calls + 1):
            client.execute(every * number, "CurJnt")
        other = story.client(50002, host="192.168.0.11")
        other.open(100)
        other.close(every * calls + 20000)

    return play


def _restarts_without_closing(story: Story) -> None:
    client = story.client()
    client.open()
    client.open(500)
    client.close(540)


def _releases_in_slave_mode(leaves: bool) -> Play:
    def play(story: Story) -> None:
        client = story.client()
        end = client.drive(20)
        if leaves:
            client.execute(end, "slvChangeMode", i4(0))
        client.close(end + 5)

    return play


def _dies_in_slave_mode(story: Story) -> None:
    client = story.client()
    client.drive(20)
    other = story.client(50002, host="192.168.0.11")
    other.open(12000)
    other.close(12100)


def _hung_up(by_controller: bool, closes: bool = False) -> Play:
    def play(story: Story) -> None:
        client = story.client(tcp=True)
        client.open()
        if closes:
            client.close(40)
        else:
            client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4s(1, 0))
        assert isinstance(client.network, Connection)
        (client.network.reset if by_controller else client.network.close)(START + 75 * MS)
        other = story.client(50002, host="192.168.0.11")
        other.open(12000)
        other.close(12100)

    return play


def _moves_and_is_gone(closes: bool) -> Play:
    """A client that did not ask for the robot's type, which is not why it is gone."""

    def play(story: Story) -> None:
        client = story.client()
        client.call(0, "Service_Start", text(",WDT=400"))
        names = map(text, ("", "CaoProv.DENSO.VRC", "localhost", ""))
        client.call(5, "Controller_Connect", *names, result=CONTROLLER)
        client.call(10, "Controller_GetRobot", CONTROLLER, text("Arm"), text(""), result=ROBOT)
        client.call(15, "Robot_Move", ROBOT, i4(1), text("P1"), text(""))
        if closes:
            client.close(40)
        other = story.client(50002, host="192.168.0.11")
        other.open(12000)
        other.close(12100)

    return play


def _executing(answered: bool, option: str = ",WDT=400") -> Play:
    def play(story: Story) -> None:
        client = story.client(tcp=True)
        client.open(option=option)
        serial = client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4s(1, 0))
        for number in range(1, 6):
            client.answer(50 + 400 * number, serial, code=_EXECUTING)
        if answered:
            client.answer(2100, serial, EMPTY)
        busy = client.ask(2200, "Robot_Execute", ROBOT, text("CurJnt"), EMPTY)
        client.answer(2201, busy, code=0 if answered else _BUSY)
        client.close(2300)

    return play


def _busy_beside(tcp: bool, code: int = _BUSY) -> Play:
    """One client waits for a Motor that is never answered; another, on its own, is refused meanwhile."""

    def play(story: Story) -> None:
        client = story.client(tcp=tcp)
        client.open()
        client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4s(1, 0))
        other = story.client(50002, tcp=tcp, host="192.168.0.11")
        other.open(100)
        other.execute(200, "CurJnt", code=code)
        other.close(300)

    return play


def _long_call(option: str, is_lost: bool = False) -> Play:
    """A Motor that takes 3 s, or is lost twice, and a client that asks again after 1 s each."""

    def play(story: Story) -> None:
        client = story.client()
        client.open(option=option)
        first = client.ask(50, "Robot_Execute", ROBOT, text("Motor"), i4s(1, 0))
        last = first
        for number in range(1, 3):
            last = client.ask(
                50 + 1000 * number, "Robot_Execute", ROBOT, text("Motor"), i4s(1, 0), reserved=first
            )
        client.answer(2053 if is_lost else 3050, last, EMPTY)
        client.close(3100)

    return play


def _given_up(lasts: int) -> Play:
    """A Robot_Move that is asked for once, and a client that asks something else after 600 ms."""

    def play(story: Story) -> None:
        client = story.client()
        client.open(option="")
        moving = client.ask(50, "Robot_Move", ROBOT, i4(1), text("P1"), text(""))
        other = client.ask(650, "Robot_Execute", ROBOT, text("CurJnt"), EMPTY)
        client.answer(50 + lasts, moving)
        client.answer(51 + lasts, other, EMPTY)
        client.close(100 + lasts)

    return play


def _option(option: str, code: int) -> Play:
    return lambda story: story.client().call(0, "Service_Start", text(option), code=code)


SCENES = (
    Scene(
        "controller-hung-up",
        _hung_up(by_controller=True),
        (9,),
        (
            "192.168.0.1:5007 reset the connection of client 192.168.0.10:50001 (TCP) (RST)",
            "25 ms after Motor 5",
            "The capture holds no reply to that call",
        ),
        _hung_up(by_controller=True, closes=True),
    ),
    Scene(
        "no-reply",
        _hung_up(by_controller=True),
        (9,),
        ("sent Motor 5 once and got no reply",),
        _hung_up(by_controller=True, closes=True),
        "controller-hung-up",
    ),
    Scene(
        "no-reply",
        _hung_up(by_controller=False),
        (9,),
        ("client 192.168.0.10:50001 (TCP) sent Motor 5 once and got no reply", "closed", "after 25 ms"),
        _hung_up(by_controller=False, closes=True),
    ),
    Scene(
        "unclean-quit",
        _hung_up(by_controller=False),
        (9,),
        ("192.168.0.10:50001 (TCP) sent nothing after 0.050 s",),
        _hung_up(by_controller=True),
        "no-reply",
    ),
    Scene(
        "unclean-quit",
        _moves_and_is_gone(closes=False),
        (7,),
        ("192.168.0.10:50001 (UDP) sent nothing after",),
        _moves_and_is_gone(closes=True),
    ),
    Scene(
        "service-not-started",
        _begins_with("Controller_GetRobot", 0x8000FFFF),
        (1, 2),
        ("Controller_GetRobot 1 of your client", "a session begins with Service_Start"),
        _begins_with("Service_Start", 0x8000FFFF),
    ),
    Scene(
        "provider-refused",
        _connects("CaoProv.DENSO.RC8", _INVALID),
        (3, 4),
        ("0x80070057", "the provider is 'CaoProv.DENSO.RC8' and the machine 'localhost'"),
        _connects("CaoProv.DENSO.VRC", 0),
    ),
    Scene(
        "name-in-use",
        _connects_twice(_NAME_USED),
        (3, 4, 7, 8),
        ("client 192.168.0.10:50001 (UDP) connected as 'cell' at 0.005 s and did not disconnect",),
        _connects_twice(0),
        "unclean-quit",
    ),
    Scene(
        "unclean-quit",
        _vanishes(12000),
        (7,),
        ("Client 192.168.0.10:50001 (UDP) sent nothing after 0.016 s", "Other clients continued for 12 s"),
        _vanishes(12000, closes=True),
    ),
    Scene(
        "unclean-quit",
        _calls_seldom(3000, 3),
        (21,),
        ("sent nothing after 9.001 s", "Other clients continued for 20 s"),
        _calls_seldom(30000, 3),
    ),
    Scene(
        "unclean-quit", _restarts_without_closing, (7, 9), ("began a new session at 0.500 s",), _vanishes(200)
    ),
    Scene(
        "quit-in-slave-mode",
        _releases_in_slave_mode(leaves=False),
        (55, 56),
        ("Your client called Robot_Release at 0.216 s while slave mode 0x202 was on",),
        _releases_in_slave_mode(leaves=True),
    ),
    Scene(
        "quit-in-slave-mode",
        _dies_in_slave_mode,
        (53,),
        ("sent no more set points after 0.203 s and left slave mode 0x202 on",),
        good,
    ),
    Scene(
        "busy",
        _executing(answered=False),
        (9, 10, 11, 12, 13, 14, 15, 16),
        ("CurJnt 6 of your client", "Motor 5, sent 2.15 s before, had no reply yet"),
        _executing(answered=True),
        "executing-forever",
    ),
    Scene(
        "busy",
        _busy_beside(tcp=False),
        (9, 18, 19),
        ("perhaps Motor 5 of client 192.168.0.10:50001 (UDP), sent 150 ms before",),
        _busy_beside(tcp=False, code=0),
    ),
    Scene(
        "busy",
        _busy_beside(tcp=True),
        (18, 19),
        (
            "CurJnt 5 of client 192.168.0.11:50002 (TCP) was refused",
            "the call that was still running could not be determined",
        ),
        _busy_beside(tcp=True, code=0),
    ),
    Scene(
        "executing-forever",
        _executing(answered=False),
        (9, 10, 11, 12, 13, 14),
        ("your client sent Motor 5, which got no final reply", "S_EXECUTING 5 times, last 2 s after"),
        _executing(answered=True),
    ),
    Scene(
        "long-call-without-wdt",
        _long_call(""),
        (1, 2, 9, 10, 11, 12),
        ("your client sent Motor 5", "after 3 s and 3 attempts, 1 s after the attempt", "no WDT"),
        _long_call(",WDT=400"),
    ),
    Scene(
        "long-call-without-wdt",
        _long_call(""),
        (1, 2, 9, 10, 11, 12),
        ("The reply came after 3 s",),
        _long_call("", is_lost=True),
    ),
    Scene(
        "long-call-without-wdt",
        _given_up(lasts=7500),
        (1, 2, 9, 11),
        ("your client sent Robot_Move 5. The reply came after 7.5 s, when the client had given up", "no WDT"),
        _given_up(lasts=500),
    ),
    Scene(
        "wdt-too-small",
        _option(",WDT=40", _INVALID),
        (1, 2),
        ("its option requests WDT=40, but 80 ms is the minimum",),
        _option(",WDT=400", _INVALID),
    ),
)
