"""Open captures, and iterate over their frames, calls, slave-mode sessions and findings."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Literal, TypeVar

from bcapscope.api.data_tables import CALL_COLUMNS, FRAME_COLUMNS, Records, TableRecords
from bcapscope.capture.capture_file import expand_folders, open_capture
from bcapscope.capture.capture_input import CaptureInput
from bcapscope.errors import CaptureError, InputError
from bcapscope.messages import Message
from bcapscope.render.escape import printable
from bcapscope.traffic.call import Call
from bcapscope.traffic.call_kind import RecentRequests
from bcapscope.traffic.capture_point import CapturePoint
from bcapscope.traffic.filter.compiler import Filter, FilterError, compile_filter
from bcapscope.traffic.filter.field_table import RecordKind
from bcapscope.traffic.filter.getters import CALL_GETTERS, FRAME_GETTERS, AnnotatedFrame
from bcapscope.traffic.joining.joined_observation import CapturePlace
from bcapscope.traffic.pipeline import CallCollector

if TYPE_CHECKING:
    from bcapscope.analysis.slave.slave_session import SlaveSession
    from bcapscope.api.reported_finding import ReportedFinding

T = TypeVar("T")

_SIDES = {"client": CapturePlace.CLIENT_SIDE, "controller": CapturePlace.CONTROLLER_SIDE}
_CAPTURE_POINTS = {point.value: point for point in CapturePoint}


class Capture:
    """One or several captures, read as one. Use `bcapscope.open` to get one.

    Attributes:
        paths: Paths of the captures. Folders are replaced by the captures in them.
    """

    def __init__(
        self,
        paths: Collection[str],
        *,
        expression: str | None,
        ports: Collection[int],
        side: CapturePlace | None,
        taken_at: CapturePoint | None,
        on_error: Callable[[str, CaptureError], object] | None,
    ) -> None:
        """Prepare to read captures, with the arguments of `open`.

        Raises CaptureError if a capture cannot be opened, and FilterError if `expression` is invalid both for
        frames and for calls.
        """
        self._expression = expression
        if expression is not None:
            _check_filter(expression)
        self._on_error = on_error
        problems = _Problems(on_error)
        self.paths: tuple[str, ...] = tuple(expand_folders(tuple(paths), problems.add))
        for path in self.paths:
            if os.path.isfile(path) or not os.path.exists(path):  # a pipe can be opened only once
                try:
                    open_capture(path).close()
                except CaptureError as error:
                    problems.add(path, error)
        problems.raise_first()
        self._open = partial(CaptureInput, self.paths, ports, side=side, taken_at=taken_at)

    @property
    def frames(self) -> TableRecords[AnnotatedFrame]:
        """The frames, and the bytes that are not a frame, in the order of their capture.

        Raises:
            FilterError: The filter is not valid for frames.
        """
        wanted = self._filter_for(RecordKind.FRAME)
        return TableRecords(lambda: self._read_frames(wanted), FRAME_COLUMNS)

    @property
    def calls(self) -> TableRecords[Call]:
        """The calls. A call is yielded when it is complete; `Call.number` counts calls in the order in which
        they started.

        Raises:
            FilterError: The filter is not valid for calls.
        """
        wanted = self._filter_for(RecordKind.CALL)
        return TableRecords(lambda: self._read_calls(wanted), CALL_COLUMNS)

    @property
    def sessions(self) -> Records[SlaveSession]:
        """The slave-mode sessions. The filter selects set points.

        Raises:
            FilterError: The filter is not valid for calls.
        """
        wanted = self._filter_for(RecordKind.CALL)
        return Records(lambda: self._read_sessions(wanted))

    @property
    def findings(self) -> Records[ReportedFinding]:
        """The findings of all rules, root cause first. The first finding is yielded after the whole capture
        was read.

        The filter selects calls. The iterator yields only findings about the selected calls, and the causes
        of these findings.

        Raises:
            FilterError: The filter is not valid for calls.
        """
        wanted = self._filter_for(RecordKind.CALL)
        return Records(lambda: self._read_findings(wanted))

    def _filter_for(self, kind: RecordKind) -> Filter | None:
        return None if self._expression is None else compile_filter(self._expression, kind)

    def _start(self) -> tuple[CaptureInput, _Problems]:
        problems = _Problems(self._on_error)
        return self._open(problems.add), problems

    def _read_frames(self, wanted: Filter | None) -> Iterator[AnnotatedFrame]:
        source, problems = self._start()
        kind_of, comments = RecentRequests().kind_of, source.decoder.comments
        frames: Iterator[AnnotatedFrame] = (
            AnnotatedFrame(seen, kind_of(seen), comments.get(seen.packet, ()) if comments else ())
            for seen in source.observations()
        )
        if wanted is not None:
            frames = filter(wanted.bind(FRAME_GETTERS, lambda: source.first_time), frames)
        yield from frames
        problems.raise_first()

    def _read_calls(self, wanted: Filter | None) -> Iterator[Call]:
        source, problems = self._start()
        collector = CallCollector(_call_test(wanted, source))
        yield from source.read_items(source.pipeline(collector), collector.calls)
        problems.raise_first()

    def _read_sessions(self, wanted: Filter | None) -> Iterator[SlaveSession]:
        from bcapscope.analysis.slave.selected_sessions import (  # noqa: PLC0415 - loads numpy
            SelectedSlaveSessions,
        )

        source, problems = self._start()
        complete: list[SlaveSession] = []
        selected = SelectedSlaveSessions(_call_test(wanted, source), complete.append)
        yield from source.read_items(source.pipeline(selected), complete)
        yield from selected.remaining_sessions(source.ended_at)
        problems.raise_first()

    def _read_findings(self, wanted: Filter | None) -> Iterator[ReportedFinding]:
        from bcapscope.analysis.diagnosis import Diagnosis  # noqa: PLC0415 - loads numpy
        from bcapscope.api.reported_finding import reported_finding  # noqa: PLC0415 - as above

        source, problems = self._start()
        diagnosis = Diagnosis(_call_test(wanted, source))
        for _ in source.read_items(source.pipeline(diagnosis), []):
            pass
        totals = diagnosis.totals(source.ended_at)
        find_frame = source.find_frame if len(source.captures.paths) > 1 else None
        for number, finding in enumerate(diagnosis.findings(source.ended_at), 1):
            yield reported_finding(number, finding, totals, find_frame)
        problems.raise_first()


def open(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    filter: str | None = None,
    ports: Collection[int] = (),
    side: Literal["client", "controller"] | None = None,
    taken_at: Literal["client", "between", "controller"] | None = None,
    on_error: Callable[[str, CaptureError], object] | None = None,
) -> Capture:
    """Open captures (pcap or pcapng, plain or gzipped) and folders of captures. The returned `Capture`
    combines the traffic of all captures.

    Several captures are read in the order of their first packets. Two captures of the same conversation,
    taken at different places, are joined.

    Args:
        paths: Path of a capture or folder, or several paths.
        filter: Filter expression, in the notation of the option `-f`. The expression selects frames for
            `Capture.frames`, and calls for the other attributes.
        ports: Ports of controllers, if they differ from the usual ports. If neither port of a conversation is
            known, the content shows which end is the controller.
        side: The side to read if a conversation was captured at the client's side and at the controller's
            side; None to join both.
        taken_at: Where the captures were taken; None to infer the place from the traffic.
        on_error: Function that receives the path and the error of a capture that cannot be read to its end.
            With `on_error`, bcapscope raises no exception, and reads the next capture.

    Raises:
        CaptureError: A capture cannot be opened, and there is no `on_error`.
        InputError: An argument is invalid. If the filter is invalid, the error is a `FilterError`.
    """
    given = [paths] if isinstance(paths, str | os.PathLike) else paths
    names = [os.fspath(path) for path in given]
    if not names:
        raise InputError(Message("capture.none-given"))
    return Capture(
        names,
        expression=filter,
        ports=ports,
        side=None if side is None else choose(side, _SIDES),
        taken_at=None if taken_at is None else choose(taken_at, _CAPTURE_POINTS),
        on_error=on_error,
    )


class _Problems:
    """Passes reading errors to `on_error`. Without `on_error`, keeps the errors for `raise_first`."""

    def __init__(self, on_error: Callable[[str, CaptureError], object] | None) -> None:
        self._on_error = on_error
        self._errors: list[CaptureError] = []

    def add(self, path: str, error: CaptureError) -> None:
        if self._on_error is not None:
            self._on_error(path, error)
            return
        named = Message("capture.named", path=printable(path), reason=error.message)
        self._errors.append(CaptureError(named, error.offset))

    def raise_first(self) -> None:
        if not self._errors:
            return
        first, *others = self._errors
        for other in others:
            first.add_note(str(other))
        raise first


def _check_filter(expression: str) -> None:
    """If `expression` is invalid for frames and for calls, raise the error with the larger `position`."""
    errors = []
    for kind in RecordKind:
        try:
            compile_filter(expression, kind)
        except FilterError as error:
            errors.append(error)
    if len(errors) == len(RecordKind):
        raise max(errors, key=lambda error: error.position)


def _call_test(wanted: Filter | None, source: CaptureInput) -> Callable[[Call], bool] | None:
    return None if wanted is None else wanted.bind(CALL_GETTERS, lambda: source.first_time)


def choose(word: str, choices: Mapping[str, T]) -> T:
    """Return `choices[word]`. Raises InputError if `word` is not in `choices`."""
    if word not in choices:
        values = ", ".join(map(repr, choices))
        raise InputError(Message("document.none-of", value=repr(word), values=values))
    return choices[word]
