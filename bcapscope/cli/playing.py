"""A player at work, as `play` shows it: what is told, what is asked, keys, signals."""

from __future__ import annotations

import select
import signal
import sys
from types import FrameType

import click

from bcapscope.cli.arming import armed_calls, can_ask, confirmed
from bcapscope.cli.exits import Exit
from bcapscope.cli.keys import Keys
from bcapscope.cli.output import echo, narrate
from bcapscope.client.action_log import LoggedConnection
from bcapscope.player.armed_messages import ArmedMessages
from bcapscope.player.limits import limited, limits_of
from bcapscope.player.messages import (
    Ended,
    Message,
    Outcome,
    Peer,
    Plan,
    Progress,
    Question,
    Readiness,
    State,
    Topic,
    Trouble,
)
from bcapscope.player.preflight import Preflight, check
from bcapscope.player.process import Player
from bcapscope.player.trajectory import Trajectory
from bcapscope.protocol.slavemode import Generation, slave_mode
from bcapscope.render.escape import printable
from bcapscope.render.palette import Palette
from bcapscope.render.playing import ended_lines, ended_record, peer_line, progress_line, trouble_lines
from bcapscope.render.preflight import PreflightRenderer, preflight_record, source_lines

_CODES = {
    Outcome.DONE: Exit.OK,
    Outcome.LOOKED: Exit.OK,
    Outcome.STOPPED: Exit.INTERRUPTED,
    Outcome.HALTED: Exit.INTERRUPTED,
    Outcome.UNARMED: Exit.UNARMED,
    Outcome.DECLINED: Exit.UNARMED,
    Outcome.UNFIT: Exit.UNFIT,
    Outcome.REFUSED: Exit.REFUSED,
    Outcome.UNANSWERED: Exit.UNANSWERED,
    Outcome.UNWRITABLE: Exit.UNWRITABLE,
    Outcome.FAILED: Exit.UNANSWERED,
}
_STOP = "s "
_HALT = ("h", "\x1b\x1b")
_KEYS = "s or Ctrl-C: come to rest, h or Escape twice: halt"
_WAIT = 1.0
_CLOSED = getattr(signal, "SIGHUP", None)


class View:
    """Writes what there is to see: data to stdout, everything else to stderr."""

    def __init__(self, as_json: bool, palette: Palette, width: int) -> None:
        self._json = as_json
        self._palette = palette
        self._width = width
        self._live = sys.stderr.isatty() and not as_json
        self._drawn = False
        self._closed = False

    def close(self) -> None:
        """Show nothing any more: the terminal was closed."""
        self._closed = True

    def source(self, trajectory: Trajectory) -> None:
        """Show how the file was read."""
        if not self._json:
            for line in source_lines(trajectory):
                echo(line)

    def preflight(self, preflight: Preflight) -> None:
        """Show the pre-flight."""
        if self._json:
            self._echo(preflight_record(preflight))
            return
        for line in PreflightRenderer(self._palette, self._width).lines(preflight):
            self._echo(line)

    def ended(self, ended: Ended) -> None:
        """Show the summary."""
        self._clear()
        if self._json:
            self._echo(ended_record(ended))
            return
        for line in ended_lines(ended):
            self._echo(line)

    def note(self, text: str) -> None:
        """Show a line on stderr."""
        self._clear()
        if not self._closed:
            narrate(text)

    def progress(self, progress: Progress) -> None:
        """Draw the one line that changes."""
        if self._live and not self._closed:
            sys.stderr.write(f"\r{progress_line(progress, self._width - 1)}\x1b[K")
            sys.stderr.flush()
            self._drawn = True

    def _clear(self) -> None:
        if self._drawn and not self._closed:
            sys.stderr.write("\r\x1b[K")
            self._drawn = False

    def _echo(self, line: str | bytes) -> None:
        if not self._closed:
            echo(line)


class Playing:
    """Runs a player to its end."""

    def __init__(self, plan: Plan, trajectory: Trajectory, view: View) -> None:
        """Get ready; nothing is started yet."""
        self._plan = plan
        self._trajectory = trajectory
        self._view = view
        self._keys = Keys()
        self._asking = False
        self._asked_to_stop = False
        self._fit = True
        self._can_ask = can_ask()

    def run(self) -> Exit:
        """Play; return the exit code."""
        connection = LoggedConnection.of_target(self._plan.target)
        with armed_calls("play", connection) as calls, Player(self._plan) as player:
            self._player, self._log = player, ArmedMessages(calls)
            before = {number: signal.signal(number, self._interrupted) for number in _signals()}
            try:
                while player.ended is None:
                    for message in self._wait():
                        self._take(message)
                self._keys.stop()
                return self._end(player.close())
            finally:
                self._keys.stop()
                for number, handler in before.items():
                    signal.signal(number, handler)

    def _end(self, ended: Ended) -> Exit:
        """Show the summary; return the exit code."""
        if self._plan.look_only and ended.outcome is Outcome.LOOKED:
            return Exit.OK if self._fit else Exit.UNFIT
        self._view.ended(ended)
        if not self._fit:
            return Exit.UNFIT
        if ended.outcome is Outcome.STOPPED and ended.index and not self._plan.rounds:
            return Exit.OK  # there is no other end
        return _CODES[ended.outcome]

    def _wait(self) -> list[Message]:
        """Wait for messages or keys."""
        watched = [self._player.fileno(), *([0] if self._keys.on else [])]
        ready, _, _ = select.select(watched, (), (), _WAIT)
        if 0 in ready:
            typed = self._keys.take()
            if any(key in typed for key in _HALT):
                self._player.halt()
            elif any(key in typed for key in _STOP):
                self._player.stop()
        return self._player.messages()

    def _take(self, message: Message) -> None:
        self._log.add(message)
        if isinstance(message, Progress):
            if message.state is State.PLAYING and not self._keys.on:
                self._keys.start()
            self._view.progress(message)
        elif isinstance(message, Question):
            self._player.answer(self._answer(message))
        elif isinstance(message, Peer):
            self._look(message)
        elif isinstance(message, Readiness) and not self._plan.look_only:
            self._view.note(message.text)
        elif isinstance(message, Trouble):
            for line in trouble_lines(message):
                self._view.note(line)

    def _look(self, peer: Peer) -> None:
        """Check the trajectory against what is there."""
        plan = self._plan
        self._view.note(peer_line(peer))
        limits = limited(limits_of(peer.type_name), plan.limits)
        found = check(
            self._trajectory,
            plan.period / 1e9,
            limits,
            present=peer.pose,
            mode=slave_mode(peer.mode, Generation(peer.generation)),
            loop=plan.rounds != 1,
        )
        self._view.preflight(found)
        self._fit = found.is_fit

    def _answer(self, question: Question) -> str:
        """Answer a question, or let the user."""
        if question.topic is Topic.BEGIN:
            if self._fit:
                self._view.note(_KEYS if self._can_ask else "Ctrl-C: come to rest, twice: halt")
            return "yes" if self._fit else "no"
        self._view.note(printable(question.text))
        if not self._can_ask:
            return question.choices[0]
        self._keys.stop()
        self._asking = True
        try:
            return self._typed(question)
        except (KeyboardInterrupt, click.Abort, EOFError):
            self._view.note("")  # what was typed has the line to itself
            self._player.stop()
            return question.choices[0]
        finally:
            self._asking = False

    def _typed(self, question: Question) -> str:
        if question.topic is Topic.ARM:
            return "yes" if confirmed(self._plan.target.host) else "no"
        choice: str = click.prompt(
            "Answer", type=click.Choice(question.choices), default=question.choices[0], err=True
        )
        return choice

    def _interrupted(self, number: int, frame: FrameType | None) -> None:
        """Stop at the first signal, halt at the second."""
        if number == _CLOSED:
            self._view.close()
        again, self._asked_to_stop = self._asked_to_stop, True
        if self._asking:
            self._asking = False  # the next one need not end the wait for an answer
            raise KeyboardInterrupt
        if again:
            self._player.halt()
        else:
            self._player.stop()


def _signals() -> list[signal.Signals]:
    # With Ctrl-Z a robot would move on, and nobody would hear a key, nor with Ctrl-\ be told how it ended.
    numbers = [signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGTSTP]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup wants it
        numbers.append(signal.SIGHUP)
    return numbers
