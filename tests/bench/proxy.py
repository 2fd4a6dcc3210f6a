"""How long a round trip of 100 bytes takes over a relay, beside the direct way.

Run from the project's root as ``python -m tests.bench.proxy`` (``trips``: flat out and paced at 1 kHz, five
runs of each way in turn, their medians) or ``python -m tests.bench.proxy robots 60`` (four clients that send
a set point each millisecond for so many seconds: what was lost, and what the memory did). Figures compare
within one run only. As root bcapscope takes real-time priority automatically. ``chrt -f 10`` gives clients,
server and all relays the priority: it keeps out whatever else the machine does, and makes the ways
comparable, as programs with real-time priority are woken on the processor where they ran last, those without
where the waker runs. ``--awake`` keeps the processors from sleeping for all ways; without it, only
``--low-latency`` does.

The ways: direct; a relay of `RELAY_C`, where there is a C compiler; socat; the least that Python can do with
epoll (`bare`); bcapscope, recording and decoding all traffic; the same with ``--low-latency``, which makes a
difference only to users who may write /dev/cpu_dma_latency.
"""

from __future__ import annotations

import argparse
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from tests.bench.awake import add_option, awake

PROXIES = {"bcapscope": (), "--low-latency": ("--low-latency",)}
"""Ways over bcapscope, each with its options."""

TRIPS = 20_000
PACED = 8_000
ROBOTS = 4

REQUEST = encode_frame(
    1,
    0,
    64,
    (Variant(VT.I4, 1), Variant(VT.BSTR, "slvMove"), Variant(VT.R4 | ARRAY, (0.5,) * 8, 8)),
)
REPLY = encode_frame(1, 0, 0, (Variant(VT.UI1 | ARRAY, bytes(74), 74),))
assert len(REQUEST) == len(REPLY) == 100

RELAY_C = r"""
#include <arpa/inet.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <sys/socket.h>
int main(int argc, char **argv) {
    int in = socket(AF_INET, SOCK_DGRAM, 0), out = socket(AF_INET, SOCK_DGRAM, 0), ep = epoll_create1(0);
    struct sockaddr_in a = {AF_INET, htons(atoi(argv[1])), {htonl(INADDR_LOOPBACK)}}, peer;
    bind(in, (void *)&a, sizeof a);
    a.sin_port = htons(atoi(argv[2]));
    connect(out, (void *)&a, sizeof a);
    struct epoll_event e = {EPOLLIN, {.fd = in}}, f = {EPOLLIN, {.fd = out}}, got;
    epoll_ctl(ep, EPOLL_CTL_ADD, in, &e);
    epoll_ctl(ep, EPOLL_CTL_ADD, out, &f);
    char data[65536];
    for (;;) {
        socklen_t size = sizeof peer;
        epoll_wait(ep, &got, 1, -1);
        if (got.data.fd == in)
            send(out, data, recvfrom(in, data, sizeof data, 0, (void *)&peer, &size), 0);
        else
            sendto(in, data, recv(out, data, sizeof data, 0), 0, (void *)&peer, sizeof peer);
    }
}
"""


def echo(port: int) -> None:
    """Answer every datagram, for ever."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    sock.bind(("127.0.0.1", port))
    reply = bytearray(REPLY)
    while True:
        data, peer = sock.recvfrom(2048)
        reply[5:7] = data[5:7]
        sock.sendto(reply, peer)


def bare(port: int, to: int) -> None:
    """Relay one client, for ever: epoll, receive, send."""
    inner = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    inner.bind(("127.0.0.1", port))
    outer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    outer.connect(("127.0.0.1", to))
    poller = select.epoll()
    for sock in (inner, outer):
        poller.register(sock.fileno(), select.EPOLLIN)
    listening = inner.fileno()
    peer: tuple[str, int] = ("", 0)
    while True:
        for ready, _ in poller.poll():
            if ready == listening:
                data, peer = inner.recvfrom(65535)
                outer.send(data)
            else:
                inner.sendto(outer.recv(65535), peer)


def free_port() -> int:
    """Return a UDP port that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(*argv: str, settle: float = 0.3) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command for the length of a block."""
    process = subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(settle)
        yield process
    finally:
        process.terminate()
        process.wait(60)


def compiled(folder: Path) -> str | None:
    """Compile the relay in C, where there is a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    source, binary = folder / "relay.c", folder / "relay"
    source.write_text(RELAY_C)
    subprocess.run([compiler, "-O2", "-o", str(binary), str(source)], check=True)
    return str(binary)


@contextmanager
def way(name: str, server: int, folder: Path) -> Iterator[int]:
    """Open a way to the server; yield the port to send to."""
    port = free_port()
    me = (sys.executable, "-m", "tests.bench.proxy")
    if name == "direct":
        yield server
        return
    if name in PROXIES:
        recording = str(folder / f"{port}.pcapng")
        spec = ("--listen", f"udp:127.0.0.1:{port}", "--to", f"127.0.0.1:{server}", "--record", recording)
        argv: tuple[str, ...] = (sys.executable, "-m", "bcapscope", "proxy", *spec, *PROXIES[name])
    elif name == "socat":
        argv = ("socat", f"UDP4-LISTEN:{port},bind=127.0.0.1", f"UDP4:127.0.0.1:{server}")
    elif name == "C":
        argv = (str(folder / "relay"), str(port), str(server))
    else:
        argv = (*me, "bare", str(port), str(server))
    with running(*argv, settle=4.0 if name in PROXIES else 1.0):
        yield port


def trips(port: int, count: int, pace: float) -> list[int]:
    """Make round trips; return how long each took, ns."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect(("127.0.0.1", port))
    sock.settimeout(5)
    request, took, clock = bytearray(REQUEST), [], time.perf_counter_ns
    send, receive = sock.send, sock.recv
    start = clock()
    for number in range(count + 200):
        request[5:7] = (number % 65535 + 1).to_bytes(2, "little")
        if pace:
            rest = start + round(number * pace * 1e9) - clock()
            if rest > 0:
                time.sleep(rest / 1e9)
        began = clock()
        send(request)
        receive(2048)
        took.append(clock() - began)
    sock.close()
    return took[200:]


def percentile(values: list[int], share: float) -> float:
    """Return a percentile in µs."""
    ordered = sorted(values)
    return ordered[min(int(len(ordered) * share), len(ordered) - 1)] / 1000


def compare(folder: Path, runs: int) -> None:
    """Print the medians of all ways."""
    names = ["direct", "bare", *PROXIES]
    if shutil.which("socat"):
        names.insert(1, "socat")
    if compiled(folder):
        names.insert(1, "C")
    server = free_port()
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    with running(sys.executable, "-m", "tests.bench.proxy", "echo", str(server), settle=1.0):
        for _ in range(runs):
            for kind, count, pace in (("flat out", TRIPS, 0.0), ("1 kHz", PACED, 0.001)):
                for name in names:
                    with way(name, server, folder) as port:
                        took = trips(port, count, pace)
                    figures = tuple(percentile(took, share) for share in (0.5, 0.99, 0.999))
                    found.setdefault((kind, name), []).append(figures)  # type: ignore[arg-type]  # three
    for kind in ("flat out", "1 kHz"):
        print(f"{kind}, µs: medians of {runs} runs, and p50 and p99.9 as multiples of socat's")
        base = [
            median(run[place] for run in found.get((kind, "socat"), found[kind, "bare"])) for place in (0, 2)
        ]
        for name in names:
            p50, p99, p999 = (median(run[place] for run in found[kind, name]) for place in range(3))
            ratio = f"{p50 / base[0]:5.2f} {p999 / base[1]:5.2f}"
            print(f"  {name:13} p50 {p50:6.1f}  p99 {p99:7.1f}  p99.9 {p999:8.1f}   {ratio}")


def robots(folder: Path, seconds: float) -> None:
    """Print what became of the set points of four robots."""
    server, port = free_port(), free_port()
    recording = str(folder / "robots.pcapng")
    spec = ("--listen", f"udp:127.0.0.1:{port}", "--to", f"127.0.0.1:{server}", "--record", recording)
    with (
        running(sys.executable, "-m", "tests.bench.proxy", "echo", str(server), settle=1.0),
        running(sys.executable, "-m", "bcapscope", "proxy", *spec, settle=4.0) as proxy,
    ):
        children = Path(f"/proc/{proxy.pid}/task/{proxy.pid}/children").read_text().split()
        processes = [proxy.pid, *map(int, children)]
        sent, heard, took = _drive(port, seconds, lambda: private_memory(processes))
        print(f"  at the end    {private_memory(processes)}")
    print(f"{ROBOTS} robots, {seconds:.0f} s: {sent} set points, {sent - heard} without an answer")
    print(f"  p50 {percentile(took, 0.5):.1f}  p99.9 {percentile(took, 0.999):.1f} µs from the tick on")


def _drive(port: int, seconds: float, memory: Callable[[], str]) -> tuple[int, int, list[int]]:
    socks = []
    for _ in range(ROBOTS):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.connect(("127.0.0.1", port))
        sock.setblocking(False)
        socks.append(sock)
    request, took, sent, clock = bytearray(REQUEST), [], 0, time.perf_counter_ns
    heard, start = 0, clock()
    ticks = round(seconds * 1000)
    for tick in range(ticks + 100):
        due = start + tick * 1_000_000
        if tick < ticks:
            request[5:7] = (tick % 65535 + 1).to_bytes(2, "little")
            for sock in socks:
                sock.send(request)
                sent += 1
        while (rest := due + 1_000_000 - clock()) > 0:
            for ready in select.select(socks, (), (), rest / 1e9)[0]:
                ready.recv(2048)
                heard += 1
                took.append(clock() - due)
        if tick % 10_000 == 5_000:
            print(f"  after {tick / 1000:5.0f} s {memory()}", flush=True)
    return sent, heard, took


def private_memory(processes: list[int]) -> str:
    """Tell how much memory each process has written for itself (smaps_rollup of proc(5))."""
    parts = []
    for pid in processes:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
        sizes = [int(line.split()[1]) for line in lines if line.startswith("Private_Dirty")]
        parts.append(f"{Path(f'/proc/{pid}/comm').read_text().strip()} {pid}: {sum(sizes) / 1000:.1f} MB")
    return ", ".join(parts)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", nargs="?", choices=("trips", "robots", "echo", "bare"), default="trips")
    parser.add_argument("numbers", nargs="*", type=float, help="of robots: seconds; of echo and bare: ports")
    parser.add_argument("--runs", type=int, default=5, help="of each way, of which the medians are shown")
    add_option(parser)
    chosen = parser.parse_args()
    numbers = [int(number) for number in chosen.numbers]
    if chosen.task == "echo":
        echo(numbers[0])
    elif chosen.task == "bare":
        bare(numbers[0], numbers[1])
    else:
        with tempfile.TemporaryDirectory() as folder, awake(chosen.awake):
            if chosen.task == "robots":
                robots(Path(folder), numbers[0] if numbers else 60)
            else:
                compare(Path(folder), chosen.runs)


if __name__ == "__main__":
    main()
