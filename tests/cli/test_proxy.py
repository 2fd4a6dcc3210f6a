"""``bcapscope proxy`` as a user runs it, before the simulator."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from bcapscope.capture.capture_file import open_capture
from bcapscope.capture.packet_decoder import PacketDecoder
from bcapscope.cli.common.exit_codes import ExitCode
from bcapscope.errors import CaptureError
from bcapscope.protocol.codec.frame import SMALLEST_FRAME, Frame, encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.protocol.retry.reserved_convention import ReservedConvention
from bcapscope.proxy.control_client import ControlClient
from bcapscope.proxy.control_messages import GetStats, ProxyStats
from bcapscope.traffic.observation import Observation
from tests.cli.proxying import PATIENCE, persistent_talk, proxy, recording, simulator, talk
from tests.cli.run import run, run_here
from tests.proxy.relaying import eventually

POINTS = int(os.environ.get("BCAPSCOPE_POINTS", "60"))
"""Set points of each session; 2000 take a minute."""

PAUSE = 0.002
"""Seconds between calls where it does not matter how many there are."""

CONVENTIONS = (
    ReservedConvention.SEED,
    ReservedConvention.OWN,
    ReservedConvention.CHAIN,
    ReservedConvention.TCP0,
    ReservedConvention.TCP1,
)


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, Path]]:
    """Run a simulator that records, its motor on, which takes longer than some have patience; give its port
    and its recording.
    """
    path = tmp_path_factory.mktemp("sim") / "sim.pcapng"
    with simulator(*recording(path)) as process:
        talk(process.port, CONVENTIONS[0], 0)
        yield process.port, path


def observed(path: Path, ports: set[int]) -> list[Observation]:
    """Read a recording of talks with servers on these ports."""
    found: list[Observation] = []
    # Where a kill came in the middle of a write, the last block breaks off.
    with open_capture(str(path)) as capture, suppress(CaptureError):
        found.extend(PacketDecoder(frozenset(ports)).decode(capture))
    return found


def said(seen: list[Observation], server: int) -> tuple[list[bytes], list[bytes]]:
    """Return the frames to and from a server's port."""
    here = [each for each in seen if each.flow.conversation.server.port == server]
    requests = [each.item.raw for each in here if each.flow.direction == "request"]
    return requests, [each.item.raw for each in here if each.flow.direction == "response"]


def sound(frames: list[bytes]) -> list[bytes]:
    """Return those that are sound frames."""
    return [raw for raw in frames if len(raw) >= SMALLEST_FRAME and not Frame(raw).problems]


def spoken(seen: list[Observation], server: int) -> dict[tuple[int, str], bytes]:
    """Return all bytes to and from a server's port, by the client's port and the direction."""
    found: dict[tuple[int, str], bytes] = {}
    for each in seen:
        conversation = each.flow.conversation
        if conversation.server.port == server:
            key = conversation.client.port, str(each.flow.direction)
            found[key] = found.get(key, b"") + each.item.raw
    return found


def calls_of(path: Path, port: int) -> list[tuple[int, int | None]]:
    """Return of each call, as `calls` tells it, how often it was tried and its result."""
    ran = run_here("calls", path, "-p", str(port), "--json")
    records = [each for each in map(json.loads, ran.lines) if each["server"] == f"127.0.0.1:{port}"]
    records.sort(key=lambda each: each["call"])
    return [(len(each["serials"]), each["hresult"]) for each in records]


def test_sessions_of_every_convention(controller: tuple[int, Path], tmp_path: Path) -> None:
    to, at_the_controller = controller
    path = tmp_path / "both.pcapng"
    began = time.time_ns()  # what clients before said may still come into its recording
    out = tmp_path / "out"
    with out.open("wb") as stdout, proxy(to, "--calls", *recording(path), stdout=stdout.fileno()) as process:
        talks = [talk(process.port, convention, POINTS) for convention in CONVENTIONS]
        notices = process.end(signal.SIGINT)
        port = process.port
    sent = [raw for each in talks for raw in each.sent]
    heard = [raw for each in talks for raw in each.heard]
    calls = [call for each in talks for call in each.calls]
    assert len(calls) == len(CONVENTIONS) * (POINTS + 10)
    seen = observed(path, {to, port})
    assert said(seen, port) == said(seen, to) == (sent, heard)
    at_last = [each for each in observed(at_the_controller, {to}) if each.time >= began]
    assert said(at_last, to) == (sent, heard)
    assert calls_of(path, port) == calls
    assert len(out.read_text().splitlines()) == len(calls)
    assert f"{len(calls)} calls, 0 retries; 5 clients" in notices
    assert "the session of" not in notices  # all were ended by their clients


def test_sessions_with_faults(controller: tuple[int, Path], tmp_path: Path) -> None:
    to, _ = controller
    path = tmp_path / "faults.pcapng"
    with proxy(to, "-q", "--fault", "loss=5%", "--seed", "7", *recording(path)) as process:
        talks = [talk(process.port, convention, POINTS, timeout=30) for convention in CONVENTIONS[:3]]
        process.end(signal.SIGTERM)
        port = process.port
    calls = [call for each in talks for call in each.calls]
    assert calls_of(path, port) == calls
    assert sum(tries > 1 for tries, _ in calls) > len(calls) // 50
    comments = [
        line for line in run_here("decode", path, "-p", str(port), "-p", str(to)).lines if "# " in line
    ]
    assert comments


def test_drops_retries_and_the_count_of_the_client_agree(
    controller: tuple[int, Path], tmp_path: Path
) -> None:
    to, _ = controller
    path = tmp_path / "loss.pcapng"
    with proxy(to, "-q", "--fault", "loss=10%", "--seed", "7", *recording(path)) as process:
        client = talk(process.port, ReservedConvention.SEED, POINTS, timeout=30)
        port, notices = process.port, process.end(signal.SIGTERM)
    seen = observed(path, {port, to})
    (asked, heard), (passed, answered) = said(seen, port), said(seen, to)
    dropped = len(asked) - len(passed) + len(answered) - len(heard)
    assert dropped > POINTS // 20
    assert f"injected {dropped} times" in notices
    assert calls_of(path, port) == client.calls
    assert len(client.sent) == len(asked) == sum(tries for tries, _ in client.calls)
    assert len(client.sent) == dropped + len(heard)  # each that got through both ways was heard


ON_TCP = (ReservedConvention.TCP0, ReservedConvention.TCP1)


@pytest.mark.parametrize(
    ("conventions", "faults"),
    [
        (ON_TCP, ["delay=1ms±1ms", "duplicate 3%"]),
        (ON_TCP, ["close 2% if command == slvMove", "close=fin 2% reply if command == slvMove"]),
        (ON_TCP, ["corrupt 2% times 2 if command == slvMove", "truncate 2% times 2 if command == slvMove"]),
        (ON_TCP[:1], ["half-open 10% times 1 if command == slvMove"]),
        (ON_TCP[1:], ["half-open 10% times 1 if command == slvMove"]),
    ],
    ids=["late and twice", "closed", "damaged", "half-open tcp0", "half-open tcp1"],
)
def test_streams_with_faults(
    tmp_path: Path, conventions: tuple[ReservedConvention, ...], faults: list[str]
) -> None:
    path, at_the_controller = tmp_path / "faults.pcapng", tmp_path / "controller.pcapng"
    words = [word for fault in faults for word in ("--fault", fault)]
    again = "half-open" not in faults[0]
    with simulator(*recording(at_the_controller)) as server:
        to = server.port
        with proxy(to, "-q", *words, "--seed", "7", *recording(path)) as process:
            talks = [persistent_talk(process.port, each, POINTS, 200, again) for each in conventions]
            notices = process.end(signal.SIGINT)
            port = process.port
        server.end(signal.SIGINT)
    assert re.search(r"fault \S+: injected (once|\d+ times)", notices), notices
    seen = observed(path, {to, port})
    asked, answered = map(sound, said(seen, port))
    assert asked == [raw for each in talks for raw in each.sent]
    # What stands behind a cut answer is told by the recording; its client may have given up by then.
    rest = iter(answered)
    assert all(raw in rest for each in talks for raw in sound(each.heard))
    assert spoken(observed(at_the_controller, {to}), to) == spoken(seen, to)
    calls = [call for each in talks for call in each.calls]
    if "corrupt" in faults[0]:  # `calls` tells the result in a damaged answer, which its client does not take
        pairs = zip(calls_of(path, port), calls, strict=True)
        assert [own for notices, own in pairs if notices != own and own[1] is not None] == []
    else:
        assert calls_of(path, port) == calls


def flood(port: int, seconds: float, pause: float = 0.0) -> tuple[int, float]:
    """Ask as fast as answers come, or after a pause; return how often, and when last, since 1970."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        sock.settimeout(PATIENCE)
        until, count = time.time() + seconds, 0
        while time.time() < until:
            count += 1
            sock.send(encode_frame(count % 65535 + 1, 0, 17))
            sock.recv(4096)
            if pause:
                time.sleep(pause)
        return count, time.time()


def ask(port: int, count: int) -> None:
    """Make calls one after another."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        sock.settimeout(PATIENCE)
        for serial in range(1, count + 1):
            sock.send(encode_frame(serial, 0, 17))
            sock.recv(4096)


@pytest.mark.parametrize("whom", ["relay", "watcher", "both"])
def test_a_kill_leaves_a_recording_that_can_be_read(
    controller: tuple[int, Path], tmp_path: Path, whom: str
) -> None:
    to, _ = controller
    path = tmp_path / "killed.pcapng"
    with proxy(to, "-q", *recording(path)) as process:
        watcher, ports = watcher_of(process.popen.pid), {process.port, to}
        count, _ = flood(process.port, 0.3)
        eventually(lambda: len(observed(path, ports)) == 4 * count, "recording")
        excused = -seconds_without_processor(watcher)
        _, last = flood(process.port, 1.0)
        # The watcher has no priority: other tests may leave it no processor for a while.
        excused += seconds_without_processor(watcher)
        victims = {"relay": [process.popen.pid], "watcher": [watcher], "both": [watcher, process.popen.pid]}
        for pid in victims[whom]:
            os.kill(pid, signal.SIGKILL)
        if whom == "watcher":
            process.wait_for("the recorder ended. The proxy still forwards traffic")
            assert flood(process.port, 0.2)[0]
            notices = process.end(signal.SIGINT, ExitCode.UNWRITABLE)
            assert f"{path} is incomplete, because the recorder ended early" in notices
        else:
            wait_for_end(watcher)
    assert run_here("decode", path).code in (0, 3)
    seen = observed(path, ports)
    assert seen[-1].time / 1e9 > last - 1.0 - excused
    for port in ports:  # nothing is missing before the end, of requests or replies
        for raw in said(seen, port):
            serials = [Frame(each).serial for each in raw[count:]]
            assert serials == list(range(2, len(serials) + 2))


def seconds_without_processor(pid: int) -> float:
    """Return how long a process has been ready to run while the processors were busy with others."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) / 1e9


def watcher_of(pid: int) -> int:
    """Return the pid of the process that records for another one."""
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise AssertionError("there is none")


def wait_for_end(pid: int) -> None:
    """Wait until a process is gone."""
    until = time.monotonic() + PATIENCE
    while Path(f"/proc/{pid}/stat").exists() and ") Z" not in Path(f"/proc/{pid}/stat").read_text():
        assert time.monotonic() < until
        time.sleep(0.02)


def test_sessions_that_are_open_are_ended_at_the_controller(
    controller: tuple[int, Path], tmp_path: Path
) -> None:
    to, at_the_controller = controller
    out, only = tmp_path / "out", 'function ~ "Service"'
    with out.open("wb") as stdout, proxy(to, "--json", "-f", only, stdout=stdout.fileno()) as process:
        left_open(process.port)
        notices = process.end(signal.SIGINT)
    assert "where slave mode is on and the arm is held, was ended" in notices
    shown = [json.loads(line) for line in out.read_bytes().splitlines()]
    assert [frame["function"] for frame in shown] == ["Service_Start"] * 2 + ["Service_Stop"] * 2
    assert shown[2]["comments"] == ["the proxy ends the session"]
    requests, _ = said(observed(at_the_controller, {to}), to)
    functions = [int.from_bytes(raw[9:13], "little") for raw in requests]
    assert functions[-5:] == [64, 64, 84, 4, 2]  # slvChangeMode 0, GiveArm, Robot_Release, disconnect, stop


def left_open(port: int) -> None:
    """Run a client that enters slave mode and is killed."""
    code = (
        "import asyncio, os\n"
        "from bcapscope.client import open_session, over_udp\n"
        "from tests.cli.proxying import drive\n"
        "async def play():\n"
        f"    async with open_session(over_udp('127.0.0.1', {port})) as session:\n"
        "        await drive(session, 20)\n"
        "        os._exit(0)\n"
        "asyncio.run(play())\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=PATIENCE)


@pytest.mark.lifecycle
def test_a_full_disk_and_a_closed_pipe_are_told_and_the_relay_goes_on(
    controller: tuple[int, Path], tmp_path: Path
) -> None:
    to, _ = controller
    path = tmp_path / "full.pcapng"
    reading, writing = os.pipe()
    with proxy(to, *recording(path), stdout=writing) as process:
        resource.prlimit(watcher_of(process.popen.pid), resource.RLIMIT_FSIZE, (20_000, 20_000))
        os.close(writing)
        os.close(reading)
        until = time.monotonic() + PATIENCE
        while f"recording to {path} stopped: file too large" not in process.err:
            assert time.monotonic() < until, process.err
            flood(process.port, 0.1, PAUSE)
        process.wait_for("standard output is closed")
        assert flood(process.port, 0.1)[0]
        process.end(signal.SIGINT, ExitCode.UNWRITABLE)
    assert run_here("decode", path).code == 0  # whole blocks only


@pytest.mark.lifecycle
def test_a_closed_terminal_ends_it_when_no_client_is_left(controller: tuple[int, Path]) -> None:
    to, _ = controller
    with proxy(to, "-q") as process:
        flood(process.port, 0.1)
        process.popen.send_signal(signal.SIGHUP)
        assert flood(process.port, 1.5, PAUSE)[0]
        assert process.popen.poll() is None
        process.end(signal.SIGINT)
    with proxy(to, "-q") as process:
        process.end(signal.SIGHUP)


@pytest.mark.skipif(not Path("/dev/shm").exists(), reason="shared memory is seen in /dev/shm")
def test_memory_of_a_proxy_that_is_killed_goes_with_it(controller: tuple[int, Path]) -> None:
    with proxy(controller[0], "-q") as process:
        shared = Path(f"/proc/{process.popen.pid}/maps").read_text(encoding="utf-8")
        names = [line.split("/dev/shm/")[1] for line in shared.splitlines() if "/dev/shm/" in line]
        assert names
        assert all(name.endswith("(deleted)") for name in names)
        process.end(signal.SIGINT)


@pytest.mark.lifecycle
@pytest.mark.skipif(not Path("/proc").exists(), reason="processes are found by /proc")
def test_ctrl_c_while_it_starts_ends_it_without_a_word() -> None:
    """The terminal sends it to all processes, also to the one that watches, which is just being loaded."""
    argv = [sys.executable, "-m", "bcapscope", "proxy", *HERE, "-q"]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdout=pipe, stderr=pipe, start_new_session=True) as process:
        until = time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < until:
            with suppress(AssertionError):
                watcher_of(process.pid)
                break
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    if process.returncode:  # else it was ready by then, and sums up
        assert (process.returncode, out, err) == (ExitCode.INTERRUPTED, b"", b"")
    assert b"Traceback" not in err
    assert b"leaked" not in err


def test_a_ring_of_files(controller: tuple[int, Path], tmp_path: Path) -> None:
    to, _ = controller
    with proxy(to, "-q", *recording(tmp_path / "r.pcapng"), "--ring", "3x30kB") as process:
        ask(process.port, 500)
        process.end(signal.SIGINT)
    files = sorted(tmp_path.iterdir())
    assert len(files) == 3
    assert all(each.name.startswith("r_0") for each in files)
    frames = [len(observed(each, {process.port, to})) for each in files]
    assert all(frames)


def test_a_stop_that_is_held_when_the_proxy_ends_is_sent_and_a_motion_is_not() -> None:
    robot = Variant(VT.I4, 1)
    halt = encode_frame(9, 0, 70, (robot, Variant(VT.BSTR, "")))
    move = encode_frame(8, 0, 64, (robot, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R4, (1.0,))))
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(PATIENCE)
        port = server.getsockname()[1]
        with proxy(port, "-q", "--fault", "delay=600s", "--control", "127.0.0.1:0") as process:
            control = ControlClient(process.wait_for(r"proxy ctl (\S+)")[1])
            with closing(control), closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as client:
                for raw in (move, halt):
                    client.sendto(raw, ("127.0.0.1", process.port))
                until = time.monotonic() + PATIENCE
                while control.request(GetStats(), ProxyStats).ruled < 2:
                    assert time.monotonic() < until
            notices = process.end(signal.SIGINT)
        assert server.recv(4096) == halt
    assert "not sent: 1 Robot_Execute slvMove" in notices


def answers(port: int, seconds: float) -> bool:
    """Tell whether datagrams come back through a port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        sock.settimeout(0.1)
        until = time.time() + seconds
        while time.time() < until:
            with suppress(OSError):
                sock.send(encode_frame(1, 0, 17))
                return bool(sock.recv(4096))
        return False


@pytest.mark.lifecycle
@pytest.mark.skipif(not hasattr(os, "openpty"), reason="there are no terminals here")
def test_a_terminal_that_nobody_reads_and_a_watcher_that_is_stopped_or_killed_hold_nothing_up(
    controller: tuple[int, Path],
) -> None:
    to, _ = controller
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    master, slave = os.openpty()
    words = ["proxy", "--listen", f"udp:127.0.0.1:{port}", "--to", f"127.0.0.1:{to}"]
    with subprocess.Popen(
        [sys.executable, "-m", "bcapscope", *words], stdin=subprocess.DEVNULL, stdout=slave, stderr=slave
    ) as process:
        try:
            assert answers(port, PATIENCE)
            assert flood(port, 1.0)[0] > 100  # far more lines than the terminal takes
            watcher = watcher_of(process.pid)
            os.kill(watcher, signal.SIGSTOP)
            assert flood(port, 1.0)[0] > 100
            os.kill(watcher, signal.SIGKILL)
            assert flood(port, 1.0)[0] > 100
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()
            os.close(master)
            os.close(slave)


@pytest.mark.lifecycle
@pytest.mark.skipif(not hasattr(os, "openpty"), reason="there are no terminals here")
def test_the_greeting_has_a_line_of_its_own_on_a_terminal() -> None:
    master, slave = os.openpty()
    argv = [sys.executable, "-m", "bcapscope", "proxy", *HERE, "-q"]
    with subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=slave, stderr=slave) as process:
        try:
            os.close(slave)
            shown = b""
            while not (b"can connect" in shown and b"0 calls" in shown):
                shown += os.read(master, 4096)
        finally:
            process.kill()
            os.close(master)
    assert re.search(rb"(?:^|\n|\x1b\[K)127\.0\.0\.1:\d+ UDP and TCP >", shown), shown


HERE = ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:1"]


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (["--listen", "127.0.0.1:0", "--ring", "x"], 2, "expected a ring of at least 2 files"),
        (["--listen", "127.0.0.1:0"], 2, "each --listen needs one --to"),
        (["--listen", "127.0.0.1:0", "--to", "127.0.0.1:1", "-f", "nonsense =="], 2, "nonsense"),
        (
            ["--listen", "127.0.0.1:0", "--to", "no.such.host.invalid:1"],
            9,
            "the controller no.such.host.invalid:1 cannot be reached",
        ),
        (["--listen", "203.0.113.7:0", "--to", "127.0.0.1:1"], 4, "cannot listen on 203.0.113.7"),
        (
            ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:1", "--record", "/nowhere/a.pcapng"],
            6,
            "no such file",
        ),
        (
            ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:1", "--record", __file__],
            6,
            "exists already. choose another path\n",
        ),
    ],
)
def test_what_cannot_be_done_is_one_sentence(words: list[str], code: int, sentence: str) -> None:
    ran = run("proxy", *words)
    assert ran.code == code, ran.err
    assert sentence in ran.err.lower()
    assert "Traceback" not in ran.err


def test_a_port_in_use_is_one_sentence() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        ran = run("proxy", "--listen", f"udp:127.0.0.1:{port}", "--to", "127.0.0.1:1")
        assert (ran.code, ran.err) == (
            4,
            f"cannot listen on 127.0.0.1 UDP port {port}: address already in use\n",
        )
