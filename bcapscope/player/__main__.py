"""The player's process: ``python -m bcapscope.player``, started by `process.Player` and by nobody else.

It has one thread and no event loop. What it is told comes on standard input, what it tells goes to standard
output; standard error is for Python's own last words.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import BinaryIO

from msgspec import structs

from bcapscope.client.target import reason_of
from bcapscope.errors import BcapError
from bcapscope.player.channel import Channel, open_channel
from bcapscope.player.controllog import read_log, write_log
from bcapscope.player.desk import Desk
from bcapscope.player.exchanger import run
from bcapscope.player.journal import Journal
from bcapscope.player.messages import Ended, Outcome, Plan, Readiness
from bcapscope.player.newfile import new_file
from bcapscope.player.realtime import undisturbed
from bcapscope.player.visit import Visit
from bcapscope.protocol.variant import Value


def main() -> None:
    """Play one plan."""
    messages = os.dup(1)
    os.dup2(2, 1)  # whatever prints does not get between the messages
    desk = Desk(0, messages)
    plan = desk.plan()
    desk.listen_to_signals()
    with ExitStack() as stack:
        try:
            record, log = (stack.enter_context(new_file(path)) for path in (plan.record, plan.log))
        except OSError as error:
            desk.deliver(Ended(Outcome.UNWRITABLE, f"{error.filename}: {reason_of(error)}"))
            desk.finish()
            return
        desk.deliver(play(plan, desk, record, log))
    desk.finish()


def play(plan: Plan, desk: Desk, record: BinaryIO | None, log: BinaryIO | None) -> Ended:
    """Play a plan; return how that ended.

    Args:
        plan: what is to be done.
        desk: is told what happens.
        record: file for all that was said.
        log: file for the controller's own log.
    """
    target = plan.target
    with undisturbed(plan.realtime and not plan.look_only) as grade:
        if plan.aftermath is None:
            desk.deliver(Readiness(grade.realtime, grade.locked, grade.text))
        try:
            port = plan.aftermath.port if plan.aftermath else 0
            channel = open_channel(target.host, target.port, target.tcp, local_port=port)
        except OSError as error:
            reason = f"{target}: {reason_of(error)}"
            return Ended(Outcome.UNANSWERED, reason, left=plan.aftermath is None, realtime=grade.realtime)
        journal = Journal(desk.deliver, record)
        visit = Visit(plan, channel, desk, journal)
        ended = structs.replace(run(visit.perform()), realtime=grade.realtime)
    # Nothing is urgent any more: files are written as anybody writes files.
    read = partial(read_log, target, plan.robot, until_ordered(desk))
    return written(ended, journal, channel, log if visit.logged else None, read)


def written(
    ended: Ended,
    journal: Journal,
    channel: Channel,
    log: BinaryIO | None,
    read: Callable[[], Sequence[Value]],
) -> Ended:
    """Write the capture and the log, which `read` gives; return how all ended."""
    reasons: list[str] = []
    try:
        journal.save(channel)
    except OSError as error:
        reasons.append(f"the capture could not be written: {reason_of(error)}")
    try:
        if log is not None:
            records = read()
            write_log(log, records)
            ended = structs.replace(ended, logged=len(records))
    except (OSError, BcapError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else str(error)
        reasons.append(f"the log could not be written: {reason}")
    if not reasons:
        return ended
    told = "; ".join((*reasons, *filter(None, (ended.reason,))))
    return structs.replace(ended, outcome=Outcome.UNWRITABLE, reason=told)


def until_ordered(desk: Desk) -> Callable[[], None]:
    """Return what looks for orders that come from now on, and raises BcapError when there is one."""
    before = desk.orders

    def look() -> None:
        desk.poll()
        if desk.orders > before:
            raise BcapError("nobody waited for it")

    return look


if __name__ == "__main__":
    main()
