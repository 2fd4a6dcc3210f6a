"""The player's process: ``python -m bcapscope.player``, started by `process.Player` and by nobody else.

It has one thread and no event loop. What it is told comes on standard input, what it tells goes to standard
output; standard error is for Python's own last words.
"""

from __future__ import annotations

import os
from contextlib import ExitStack
from typing import TextIO

from msgspec import structs

from bcapscope.client.target import reason_of
from bcapscope.errors import BcapError
from bcapscope.player.channel import open_channel
from bcapscope.player.controllog import read_log, write_log
from bcapscope.player.desk import Desk
from bcapscope.player.exchanger import run
from bcapscope.player.journal import Journal
from bcapscope.player.messages import Ended, Outcome, Plan, Readiness
from bcapscope.player.realtime import Grade, undisturbed
from bcapscope.player.visit import Visit


def main() -> None:
    """Play one plan."""
    messages = os.dup(1)
    os.dup2(2, 1)  # whatever prints does not get between the messages
    desk = Desk(0, messages)
    plan = desk.plan()
    desk.listen_to_signals()
    with ExitStack() as stack:
        try:
            journal = Journal(desk.deliver, plan.record)
            log = None if plan.log is None else stack.enter_context(_new(plan.log))
        except OSError as error:
            desk.deliver(Ended(Outcome.UNWRITABLE, f"{error.filename}: {reason_of(error)}"))
            desk.finish()
            return
        grade = stack.enter_context(undisturbed(plan.realtime and not plan.look_only))
        desk.deliver(Readiness(grade.realtime, grade.locked, grade.text))
        desk.deliver(_play(plan, desk, journal, log, grade))
    desk.finish()


def _new(path: str) -> TextIO:
    return open(path, "x", encoding="utf-8")


def _play(plan: Plan, desk: Desk, journal: Journal, log: TextIO | None, grade: Grade) -> Ended:
    target = plan.target
    try:
        channel = open_channel(target.host, target.port, target.tcp)
    except OSError as error:
        return Ended(Outcome.UNANSWERED, f"{target}: {reason_of(error)}")
    visit = Visit(plan, channel, desk, journal)
    ended = run(visit.perform())
    ended = structs.replace(ended, realtime=grade.realtime)
    try:
        if log is not None and visit.logged:
            records = read_log(target, plan.robot)
            write_log(log, records)
            log.flush()
            ended = structs.replace(ended, logged=len(records))
        journal.save(channel)
    except (OSError, BcapError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else str(error)
        told = f"the log or the capture could not be written: {reason}"
        more = f"; {ended.reason}" if ended.reason else ""
        return structs.replace(ended, outcome=Outcome.UNWRITABLE, reason=told + more)
    return ended


if __name__ == "__main__":
    main()
