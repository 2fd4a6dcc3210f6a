"""The player's end of the pipes: orders, answers, readers that sleep and programs that go away."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from bcapscope.client.controller_target import ControllerTarget
from bcapscope.messages import Message
from bcapscope.player.player_messages import (
    Order,
    PlayEnded,
    PlayerCommand,
    PlayerQuestion,
    PlayOutcome,
    PlayPlan,
    PlayProgress,
    PlayState,
    QuestionTopic,
    decode_message,
    encode_message,
)
from bcapscope.player.player_pipe import PARENT_GONE, PlayerPipe

QUESTION = PlayerQuestion(QuestionTopic.ARM, Message("play.question.begin"), ("no", "yes"))


class Ends:
    """The other ends.

    Attributes:
        pipe: that is tested.
    """

    def __init__(self) -> None:
        commands, self._orders = os.pipe()
        self._told, messages = os.pipe()
        self._own = [commands, messages]
        self.pipe = PlayerPipe(commands, messages)
        os.set_blocking(commands, False)

    def order(self, command: PlayerCommand) -> None:
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
    assert ends.pipe.poll_order() is None
    ends.order(PlayerCommand(Order.STOP))
    assert ends.pipe.poll_order() is Order.STOP
    ends.order(PlayerCommand(Order.HALT))
    assert ends.pipe.poll_order() is Order.HALT
    ends.order(PlayerCommand(Order.STOP))
    assert (ends.pipe.poll_order(), str(ends.pipe.reason or "")) == (Order.HALT, "halt was requested")


def test_an_order_in_two_pieces_is_one(ends: Ends) -> None:
    whole = encode_message(PlayerCommand(Order.STOP)) + b"\n"
    ends.write(whole[:5])
    assert ends.pipe.poll_order() is None
    ends.write(whole[5:])
    assert ends.pipe.poll_order() is Order.STOP


def test_the_other_end_gone_is_an_order_to_stop(ends: Ends) -> None:
    ends.hang_up()
    assert (ends.pipe.poll_order(), ends.pipe.reason) == (Order.STOP, PARENT_GONE)
    ends.pipe.send(PlayEnded(PlayOutcome.STOPPED))
    ends.pipe.wait_until_sent()


def test_a_reader_gone_is_one_too(ends: Ends) -> None:
    ends.hang_up()
    assert not ends.pipe.try_send(PlayProgress(PlayState.PLAYING))
    assert ends.pipe.order is Order.STOP


def test_progress_is_left_out_while_nobody_reads_and_the_rest_waits(ends: Ends) -> None:
    told = 0
    while ends.pipe.try_send(PlayProgress(PlayState.PLAYING, told)):
        told += 1
    assert told > 50
    ends.pipe.send(PlayEnded(PlayOutcome.DONE))
    assert not ends.pipe.try_send(PlayProgress(PlayState.PLAYING, 999_999))
    data = ends.read()
    ends.pipe.wait_until_sent()
    data += ends.read()
    found = [decode_message(line) for line in data.splitlines()]
    assert found[-1] == PlayEnded(PlayOutcome.DONE)
    numbers = [each.index for each in found if isinstance(each, PlayProgress)]
    assert numbers == list(range(told))


def test_a_question_is_answered(ends: Ends) -> None:
    ends.order(PlayerCommand(answer="yes"))
    ends.pipe.poll_order()
    ends.order(PlayerCommand(answer="yes"))
    assert ends.pipe.ask(QUESTION) == "yes"
    assert decode_message(ends.read().strip()) == QUESTION


@pytest.mark.parametrize("command", [PlayerCommand(answer="perhaps"), PlayerCommand(Order.STOP)])
def test_what_is_no_answer_is_the_first_choice(ends: Ends, command: PlayerCommand) -> None:
    ends.order(command)
    assert ends.pipe.ask(QUESTION) == "no"


def test_nobody_to_ask_is_the_first_choice(ends: Ends) -> None:
    ends.hang_up()
    assert ends.pipe.ask(QUESTION) == "no"


def test_a_plan_and_an_order_in_one_piece() -> None:
    ends = Ends()
    plan = PlayPlan(target=ControllerTarget("host"), points=[(1.0, 2.0)])
    ends.write(encode_message(plan) + b"\n" + encode_message(PlayerCommand(Order.STOP)) + b"\n")
    found = ends.pipe.read_plan()
    assert (found.target, list(found.points)) == (plan.target, [(1.0, 2.0)])
    assert ends.pipe.poll_order() is Order.STOP
    ends.close()
