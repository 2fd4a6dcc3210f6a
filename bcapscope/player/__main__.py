"""The player's process: ``python -m bcapscope.player``, started only by `player_process.PlayerProcess`.

One thread, without an event loop, reads orders from standard input and writes messages to standard output.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import BinaryIO

from msgspec import structs

from bcapscope.capture.rotating_recording import RotatingRecording
from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.messages.places import Enumeration
from bcapscope.player.blocking_caller import Channel, open_channel, run_blocking
from bcapscope.player.control_log import open_new_file, read_control_log, write_control_log
from bcapscope.player.frame_recorder import FrameRecorder, open_recording
from bcapscope.player.play_session import PlaySession
from bcapscope.player.player_messages import PlayEnded, PlayOutcome, PlayPlan
from bcapscope.player.player_pipe import PlayerPipe
from bcapscope.player.realtime import realtime_priority
from bcapscope.protocol.codec.variant import Value


def main() -> None:
    messages = os.dup(1)
    os.dup2(2, 1)  # text that a module prints must not mix with the messages
    pipe = PlayerPipe(0, messages)
    plan = pipe.read_plan()
    pipe.install_signal_handlers()
    with ExitStack() as stack:
        try:
            recording = stack.enter_context(open_recording(plan.record))
            log = stack.enter_context(open_new_file(plan.log))
        except OSError as error:
            reason = Message("file.not-written", path=error.filename, reason=os_reason(error))
            ended = PlayEnded(PlayOutcome.UNWRITABLE, reason)
        else:
            ended = play(plan, pipe, recording, log)
        pipe.send(ended)
    pipe.wait_until_sent()


def play(
    plan: PlayPlan, pipe: PlayerPipe, recording: RotatingRecording | None, log: BinaryIO | None
) -> PlayEnded:
    """Play a plan. Record all frames if there is a `recording`, and save the controller's log in `log`."""
    target = plan.target
    with realtime_priority(plan.realtime and not plan.look_only) as granted:
        if plan.aftermath is None:
            pipe.send(granted)
        try:
            port = plan.aftermath.port if plan.aftermath else 0
            channel = open_channel(target.host, target.port, target.tcp, local_port=port)
        except OSError as error:
            reason = Message("connection.failed", target=str(target), reason=os_reason(error))
            return PlayEnded(
                PlayOutcome.UNANSWERED, reason, left=plan.aftermath is None, realtime=granted.realtime
            )
        recorder = FrameRecorder(pipe.send, recording)
        session = PlaySession(plan, channel, pipe, recorder)
        ended = structs.replace(run_blocking(session.run()), realtime=granted.realtime)
    # The player writes the recording and the controller's log without real-time priority.
    read = partial(read_control_log, target, plan.robot, abort_on_order(pipe))
    return write_files(ended, recorder, channel, log if session.has_log else None, read)


def write_files(
    ended: PlayEnded,
    recorder: FrameRecorder,
    channel: Channel,
    log: BinaryIO | None,
    read_records: Callable[[], Sequence[Value]],
) -> PlayEnded:
    """Write the recording and, if there is a `log`, the records that `read_records` returns."""
    reasons: list[Message] = []
    try:
        recorder.save_capture(channel)
    except OSError as error:
        reasons.append(Message("play.capture-not-written", reason=os_reason(error)))
    try:
        if log is not None:
            records = read_records()
            write_control_log(log, records)
            ended = structs.replace(ended, logged=len(records))
    except (OSError, BcapError) as error:
        reason = os_reason(error) if isinstance(error, OSError) else error.message
        reasons.append(Message("play.log-not-written", reason=reason))
    if not reasons:
        return ended
    if ended.reason is not None:
        reasons.append(ended.reason)
    reason = reasons[0] if len(reasons) == 1 else Message("list.of", items=Enumeration(tuple(reasons)))
    return structs.replace(ended, outcome=PlayOutcome.UNWRITABLE, reason=reason)


def abort_on_order(pipe: PlayerPipe) -> Callable[[], None]:
    """Return a function that raises BcapError if the parent process has sent a further order."""
    before = pipe.order_count

    def look() -> None:
        pipe.poll_order()
        if pipe.order_count > before:
            raise BcapError(Message("player.order-came"))

    return look


if __name__ == "__main__":
    main()
