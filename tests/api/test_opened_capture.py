"""Captures, as programs of users read them: the same as the commands show."""

from __future__ import annotations

import json
import os
import tracemalloc
from pathlib import Path

import pytest

import bcapscope
from tests.cli.run import run_here
from tests.cli.test_several_captures import as_pcap, packets_of

ROOT = Path(__file__).parent.parent.parent
CAPTURES = ROOT / "captures"
LOST = str(CAPTURES / "slave-mode-lost.pcapng")
SAMPLES = sorted(str(path) for path in CAPTURES.glob("*.pcap*"))


def records(*args: str) -> list[dict[str, object]]:
    """Return the JSON objects that a command prints."""
    return [json.loads(line) for line in run_here(*args, "--json").lines]


def shown(args: list[str], *names: str) -> list[tuple[object, ...]]:
    """Return some members of the JSON objects that a command prints."""
    return [tuple(each.get(name) for name in names) for each in records(*args)]


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: Path(path).name)
def test_the_records_are_those_of_the_commands(path: str) -> None:
    capture = bcapscope.open(path)
    frames = [(f.number, f.kind, f.function, f.command, f.hresult) for f in capture.frames]
    assert frames == shown(["decode", path], "frame", "kind", "function", "command", "hresult")
    calls = [(c.number, c.function, c.command, c.outcome, c.retries) for c in capture.calls]
    assert calls == shown(["calls", path], "call", "function", "command", "outcome", "retries")
    findings = [(f.number, f.rule, f.text(), list(f.frames)) for f in capture.findings]
    assert findings == shown(["diagnose", path], "finding", "rule", "sentence", "frames")
    assert [(s.number,) for s in capture.sessions] == shown(["slave", path], "stay")


@pytest.fixture
def parts(tmp_path: Path) -> tuple[Path, Path]:
    """A capture in two files, of which the later one has the first name."""
    packets = packets_of(Path(LOST))
    later, earlier = tmp_path / "a.pcap", tmp_path / "b.pcap"
    later.write_bytes(as_pcap(packets[30:]))
    earlier.write_bytes(as_pcap(packets[:30]))
    return later, earlier


def test_several_files_and_folders_are_read_as_one(parts: tuple[Path, Path]) -> None:
    whole = [frame.raw for frame in bcapscope.open(LOST).frames]
    assert [frame.raw for frame in bcapscope.open(parts).frames] == whole
    capture = bcapscope.open(parts[0].parent)
    assert [frame.raw for frame in capture.frames] == whole
    assert sorted(capture.paths) == sorted(map(str, parts))


def test_the_findings_of_several_files_are_those_of_one(parts: tuple[Path, Path]) -> None:
    rules = [finding.rule for finding in bcapscope.open(LOST).findings]
    assert [finding.rule for finding in bcapscope.open(parts).findings] == rules


def test_two_places_are_joined_or_read_apart(tmp_path: Path) -> None:
    packets = packets_of(Path(LOST))
    for name, delay in (("near", 0), ("far", 200_000)):
        (tmp_path / f"{name}.pcap").write_bytes(
            as_pcap([(time + delay, *rest) for time, *rest in packets])  # type: ignore[misc]
        )
    count = sum(1 for _ in bcapscope.open(LOST).calls)
    assert sum(1 for _ in bcapscope.open(tmp_path).calls) == count
    assert sum(1 for _ in bcapscope.open(tmp_path, side="controller").calls) == count
    assert sum(1 for _ in bcapscope.open(tmp_path).frames) == 2 * sum(1 for _ in bcapscope.open(LOST).frames)


def test_each_iteration_reads_again_and_two_can_be_mixed() -> None:
    frames = bcapscope.open(LOST).frames
    assert [one.number for one, _ in zip(frames, frames, strict=True)] == [frame.number for frame in frames]


def test_the_filter_selects_as_in_the_commands() -> None:
    expression = "command == slvMove and t > 0.3"
    capture = bcapscope.open(LOST, filter=expression)
    frames = [each["frame"] for each in records("decode", LOST, "-f", expression)]
    assert [frame.number for frame in capture.frames] == frames
    assert [call.number for call in capture.calls] == [
        each["call"] for each in records("calls", LOST, "-f", expression)
    ]
    assert [finding.rule for finding in capture.findings] == [
        each["rule"] for each in records("diagnose", LOST, "-f", expression)
    ]


def test_a_filter_for_calls_only_is_refused_for_frames() -> None:
    capture = bcapscope.open(LOST, filter="latency > 1us")
    assert list(capture.calls)
    with pytest.raises(bcapscope.FilterError, match="latency is a field of calls, not of frames"):
        _ = capture.frames


@pytest.mark.parametrize(
    ("expression", "sentence"), [("latency > ", "value"), ("serial > > 3", "value"), ("", "empty")]
)
def test_an_invalid_filter_is_refused_at_once(expression: str, sentence: str) -> None:
    with pytest.raises(bcapscope.FilterError, match=sentence):
        bcapscope.open(LOST, filter=expression)


def test_a_missing_capture_is_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(bcapscope.CaptureError, match=r"none\.pcap: cannot be opened: no such file"):
        bcapscope.open([LOST, tmp_path / "none.pcap"])


def test_a_folder_without_captures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(bcapscope.CaptureError, match=str(tmp_path)):
        bcapscope.open(tmp_path)


@pytest.fixture
def cut(parts: tuple[Path, Path]) -> Path:
    """The earlier of two files, cut in its last packet."""
    parts[1].write_bytes(parts[1].read_bytes()[:-3])
    return parts[1]


@pytest.mark.parametrize("records_name", ["frames", "calls", "sessions", "findings"])
def test_damage_is_raised_after_all_that_can_be_read(cut: Path, records_name: str) -> None:
    found: list[object] = []
    capture = bcapscope.open(cut.parent)
    with pytest.raises(bcapscope.CaptureError, match=r"b\.pcap: ") as caught:
        found.extend(getattr(capture, records_name))
    assert found
    assert caught.value.offset


def test_the_other_errors_are_notes_of_the_first(parts: tuple[Path, Path]) -> None:
    for path in parts:
        path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(bcapscope.CaptureError) as caught:
        list(bcapscope.open(parts).frames)
    assert len(caught.value.__notes__) == 1


def test_errors_go_to_a_function_of_the_caller(cut: Path) -> None:
    errors: list[tuple[str, bcapscope.CaptureError]] = []
    frames = list(bcapscope.open(cut, on_error=lambda *error: errors.append(error)).frames)
    assert len(frames) == 29
    assert [path for path, _ in errors] == [str(cut)]


def test_the_file_is_closed_when_an_iteration_is_given_up() -> None:
    descriptors = "/proc/self/fd"
    if not os.path.isdir(descriptors):
        pytest.skip("this system has no /proc/self/fd")
    before = len(os.listdir(descriptors))
    frames = iter(bcapscope.open(LOST).frames)
    next(frames)
    assert len(os.listdir(descriptors)) == before + 1
    del frames
    assert len(os.listdir(descriptors)) == before


@pytest.mark.parametrize(
    ("records_name", "least_per_copy", "few", "many"),
    [
        ("frames", 200, 10, 40),
        ("calls", 200, 10, 40),
        ("sessions", 1, 10, 40),
        ("findings", 0, 80, 160),  # the calls that rules remember are bounded, but 40 copies do not fill them
    ],
)
def test_memory_stays_flat(
    tmp_path: Path, records_name: str, least_per_copy: int, few: int, many: int
) -> None:
    packets = packets_of(CAPTURES / "slave-session.pcapng")
    lasts = packets[-1][0] - packets[0][0] + 10**9

    def peak_of(copies: int) -> int:
        path = tmp_path / f"{copies}.pcap"
        path.write_bytes(
            as_pcap([(time + number * lasts, *rest) for number in range(copies) for time, *rest in packets])  # type: ignore[misc]
        )
        tracemalloc.start()
        count = sum(1 for _ in getattr(bcapscope.open(path), records_name))
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert count >= max(1, least_per_copy * copies)
        return peak

    peak_of(10)
    assert peak_of(many) < 1.5 * peak_of(few)


def test_no_capture_at_all_is_an_input_error() -> None:
    with pytest.raises(bcapscope.InputError, match="no capture was given"):
        bcapscope.open([])


def test_an_unknown_word_is_an_input_error() -> None:
    with pytest.raises(bcapscope.InputError, match="'left' is not one of 'client', 'controller'"):
        bcapscope.open(LOST, side="left")  # type: ignore[arg-type]
    with pytest.raises(bcapscope.InputError, match="'left' is not one of 'client'"):
        bcapscope.open(LOST, taken_at="left")  # type: ignore[arg-type]
    finding = next(iter(bcapscope.open(LOST).findings))
    with pytest.raises(bcapscope.InputError, match="'fr' is not one of 'en', 'ja'"):
        finding.text("fr")  # type: ignore[arg-type]


def test_findings_have_both_languages() -> None:
    finding = next(iter(bcapscope.open(LOST).findings))
    assert finding.text("ja") != finding.text() == finding.text("en")
    assert finding.advice_text("ja") != finding.advice_text()
    assert (finding.number, finding.consequence_of, finding.totals.frames) == (1, None, 70)
