"""The player's end of the pipes: orders, answers, readers that sleep and programs that go away."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from bcapscope.client.target import Target
from bcapscope.player.desk import GONE, Desk
from bcapscope.player.messages import (
    Command,
    Ended,
    Order,
    Outcome,
    Plan,
    Progress,
    Question,
    State,
    Topic,
    decode_message,
    encode_message,
)

QUESTION = Question(Topic.ARM, "really?", ("no", "yes"))


class Ends:
    """The other ends.

    Attributes:
        desk: that is tested.
    """

    def __init__(self) -> None:
        commands, self._orders = os.pipe()
        self._told, messages = os.pipe()
        self._own = [commands, messages]
        self.desk = Desk(commands, messages)
        os.set_blocking(commands, False)

    def order(self, command: Command) -> None:
        """Give an order or an answer."""
        os.write(self._orders, encode_message(command) + b"\n")

    def write(self, data: bytes) -> None:
        """Write anything."""
        os.write(self._orders, data)

    def hang_up(self) -> None:
        """Go away."""
        for end in (self._orders, self._told):
            os.close(end)
        self._orders = self._told = -1

    def read(self) -> bytes:
        """Return what was told."""
        return os.read(self._told, 1 << 20)

    def close(self) -> None:
        """Close all that is open."""
        for end in (*self._own, self._orders, self._told):
            if end >= 0:
                os.close(end)


@pytest.fixture
def ends() -> Iterator[Ends]:
    made = Ends()
    yield made
    made.close()


def test_orders_are_taken_as_they_come(ends: Ends) -> None:
    assert ends.desk.poll() is None
    ends.order(Command(Order.STOP))
    assert ends.desk.poll() is Order.STOP
    ends.order(Command(Order.HALT))
    assert ends.desk.poll() is Order.HALT
    ends.order(Command(Order.STOP))
    assert (ends.desk.poll(), ends.desk.reason) == (Order.HALT, "halt was asked for")


def test_an_order_in_two_pieces_is_one(ends: Ends) -> None:
    whole = encode_message(Command(Order.STOP)) + b"\n"
    ends.write(whole[:5])
    assert ends.desk.poll() is None
    ends.write(whole[5:])
    assert ends.desk.poll() is Order.STOP


def test_the_other_end_gone_is_an_order_to_stop(ends: Ends) -> None:
    ends.hang_up()
    assert (ends.desk.poll(), ends.desk.reason) == (Order.STOP, GONE)
    ends.desk.deliver(Ended(Outcome.STOPPED))
    ends.desk.finish()


def test_a_reader_gone_is_one_too(ends: Ends) -> None:
    ends.hang_up()
    assert not ends.desk.tell(Progress(State.PLAYING))
    assert ends.desk.order is Order.STOP


def test_progress_is_left_out_while_nobody_reads_and_the_rest_waits(ends: Ends) -> None:
    told = 0
    while ends.desk.tell(Progress(State.PLAYING, told)):
        told += 1
    assert told > 50
    ends.desk.deliver(Ended(Outcome.DONE))
    assert not ends.desk.tell(Progress(State.PLAYING, 999_999))
    data = ends.read()
    ends.desk.finish()
    data += ends.read()
    found = [decode_message(line) for line in data.splitlines()]
    assert found[-1] == Ended(Outcome.DONE)
    numbers = [each.index for each in found if isinstance(each, Progress)]
    assert numbers == list(range(told))


def test_a_question_is_answered(ends: Ends) -> None:
    ends.order(Command(answer="yes"))
    ends.desk.poll()
    ends.order(Command(answer="yes"))
    assert ends.desk.ask(QUESTION) == "yes"
    assert decode_message(ends.read().strip()) == QUESTION


@pytest.mark.parametrize("command", [Command(answer="perhaps"), Command(Order.STOP)])
def test_what_is_no_answer_is_the_first_choice(ends: Ends, command: Command) -> None:
    ends.order(command)
    assert ends.desk.ask(QUESTION) == "no"


def test_nobody_to_ask_is_the_first_choice(ends: Ends) -> None:
    ends.hang_up()
    assert ends.desk.ask(QUESTION) == "no"


def test_a_plan_and_an_order_in_one_piece() -> None:
    ends = Ends()
    plan = Plan(target=Target("host"), points=[(1.0, 2.0)])
    ends.write(encode_message(plan) + b"\n" + encode_message(Command(Order.STOP)) + b"\n")
    found = ends.desk.plan()
    assert (found.target, list(found.points)) == (plan.target, [(1.0, 2.0)])
    assert ends.desk.poll() is Order.STOP
    ends.close()
