"""``bcapscope extract``: write slave-mode trajectories, one file per session."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import click

from bcapscope.analysis.slave.captured_trajectory import (
    CapturedTrajectory,
    TrajectoryExtractor,
    TrajectoryPiece,
    TrajectoryStep,
)
from bcapscope.cli.common import options
from bcapscope.cli.common.capture_reader import CaptureReader
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.cli.common.output_files import AtomicFile, check_output_path, force_option
from bcapscope.live.end_signals import interrupt_on_end_signals
from bcapscope.live.standard_streams import print_stderr
from bcapscope.messages import Message, MessageFormatter
from bcapscope.messages.places import Count
from bcapscope.render.escape import printable
from bcapscope.render.statistics_text import conversation_text
from bcapscope.render.trajectory_file import CsvTrajectoryWriter, JsonTrajectoryWriter
from bcapscope.traffic.filter.compiler import Filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.observation import Conversation

TrajectoryWriter: TypeAlias = CsvTrajectoryWriter | JsonTrajectoryWriter

_WRITERS: dict[str, Callable[[CapturedTrajectory], TrajectoryWriter]] = {
    ".csv": CsvTrajectoryWriter,
    ".json": JsonTrajectoryWriter,
}


@click.command()
@options.captures
@options.output_option(
    "Write to this file, whose name ends in .csv or .json. With several sessions, each file name gets the "
    "number of the session."
)
@options.ports
@click.option(
    "--client",
    metavar="ADDRESS",
    help="Write only the set points of this client, given as address or address:port.",
)
@options.side
@options.taken_at
@options.filter_option(RecordKind.CALL)
@force_option
@options.language
def command(
    *,
    output: Path,
    client: str | None,
    wanted: Filter | None,
    force: bool,
    words: MessageFormatter,
    **source: Any,
) -> None:
    """Write the set points of slave mode (slvMove), each with the pose that the controller returned.

    Each row shows one set point and the time of its first attempt. Retries add no rows. Set points that the
    controller refused are left out. A set point is included even if its reply was not captured.

    Each slave-mode session gets a file: FILE.csv if there is one session; FILE-1.csv, FILE-2.csv and so on
    if there are several. The number in a file name is the number of the session in the capture. Existing
    files are not overwritten without --force.

    Exit codes: 0: everything was written; 2: invalid command line; 3: a capture is damaged or incomplete,
    and everything before the damage was written; 4: nothing could be read; 5: there are no set points to
    write; 6: a file was not written.
    """
    if output.suffix.casefold() not in _WRITERS:
        raise click.BadParameter(
            f"{printable(str(output))} does not end in .csv or .json", param_hint="--output"
        )
    interrupt_on_end_signals()
    files = _TrajectoryFiles(output, force, words)
    reading = CaptureReader(words=words, **source)
    trajectories = TrajectoryExtractor(
        reading.call_test(wanted), None if client is None else _is_by_client(client)
    )
    with files:
        for trajectory, steps in _read_pieces(reading, trajectories):
            files.add(trajectory, steps)
            reading.show_progress()
        written = files.commit()
    reading.print_summary()
    for line in written:
        print_stderr(line)
    if trajectories.set_points or reading.exit_code is not ExitCode.UNREADABLE:
        _print_left_out(trajectories, client, bool(written), words)
    sys.exit(reading.exit_code if written or reading.exit_code else ExitCode.NO_DATA)


def _is_by_client(client: str) -> Callable[[Conversation], bool]:
    return lambda conversation: client in (str(conversation.client), conversation.client.host)


def _read_pieces(reader: CaptureReader, trajectories: TrajectoryExtractor) -> Iterator[TrajectoryPiece]:
    yield from reader.read_items(reader.pipeline(trajectories), trajectories.ready)
    trajectories.finish()
    yield from trajectories.ready


def _print_left_out(
    trajectories: TrajectoryExtractor, client: str | None, some: bool, words: MessageFormatter
) -> None:
    suffix, whose = ("", {}) if client is None else (".by-client", {"client": printable(client)})
    if not trajectories.set_points:
        print_stderr(words(f"extract.no-set-points{suffix}", **whose))
        return
    reasons = [f"{count} {reason.message}" for reason, count in trajectories.left_out.items()]
    if reasons:
        print_stderr(words("extract.left-out", reasons=words("list.comma").join(reasons)))
    if not some:
        count = Count(trajectories.set_points, "set-point")
        print_stderr(words(f"extract.no-trajectory{suffix}", set_points=count, **whose))


@dataclass(slots=True)
class _TrajectoryFile:
    trajectory: CapturedTrajectory
    file: AtomicFile
    writer: TrajectoryWriter
    points: int = 0
    unanswered: int = 0
    last: int = 0

    def add(self, steps: Sequence[TrajectoryStep]) -> None:
        self.file.write(self.writer.rows(steps))
        self.points += len(steps)
        self.unanswered += sum(step.reply_time is None for step in steps)
        self.last = steps[-1].time


class _TrajectoryFiles(ExitStack):
    """The files of all sessions. With several files, each name contains the number of the session; a single
    file has no number. Therefore only `commit`, which knows how many files there are, gives the final names.
    """

    def __init__(self, path: Path, overwrite: bool, words: MessageFormatter) -> None:
        super().__init__()
        self._words = words
        self._path = path
        self._overwrite = overwrite
        self._outputs: dict[int, _TrajectoryFile] = {}
        check_output_path(path, overwrite)

    def add(self, trajectory: CapturedTrajectory, steps: Sequence[TrajectoryStep]) -> None:
        output = self._outputs.get(trajectory.session_number) or self._open(trajectory)
        output.add(steps)

    def commit(self) -> list[str]:
        several = len(self._outputs) > 1
        for number, output in self._outputs.items():
            check_output_path(self._name(number if several else None), self._overwrite)
            output.file.write(output.writer.tail())
        summaries = []
        for number, output in sorted(self._outputs.items()):
            path = self._name(number if several else None)
            output.file.commit(path, self._overwrite)
            summaries.append(f"{printable(str(path))}: {self._words.text(_file_summary(output))}")
        return summaries

    def _open(self, trajectory: CapturedTrajectory) -> _TrajectoryFile:
        path = self._name(trajectory.session_number)
        writer = _WRITERS[path.suffix.casefold()](trajectory)
        file = self.enter_context(AtomicFile(path))
        file.write(writer.head())
        output = self._outputs[trajectory.session_number] = _TrajectoryFile(trajectory, file, writer)
        return output

    def _name(self, number: int | None) -> Path:
        return self._path if number is None else self._path.with_stem(f"{self._path.stem}-{number}")


def _file_summary(output: _TrajectoryFile) -> Message:
    trajectory = output.trajectory
    seconds = f"{(output.last - trajectory.start) / 1e9:.3f}"
    points = Message("extract.points", points=Count(output.points, "set-point"), seconds=seconds)
    if output.unanswered:
        points = Message("extract.points.unanswered", points=points, unanswered=output.unanswered)
    mode, pose = Message("extract.mode-unseen"), str(trajectory.mode.pose_type)
    if trajectory.mode.value is not None:
        mode = Message("extract.mode", mode=f"0x{trajectory.mode.value:03X}")
    ends = conversation_text(trajectory.conversation)
    return Message("extract.file", points=points, pose=pose, mode=mode, ends=ends)
