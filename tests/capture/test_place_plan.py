"""Which capture files hold the same conversation."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from bcapscope.capture import place_plan
from bcapscope.capture.capture_file import CaptureFile, open_capture
from bcapscope.capture.place_plan import PlacePlan, plan_places
from tests.samples.calls import CLIENT, MS, SERVER, START, US, Datagrams
from tests.samples.files import pcap
from tests.samples.legs import PROXY_FAR, PROXY_NEAR, TwoPlaces, both_ends

SECOND = 1000 * MS
PORTS = frozenset({5007})


def written(folder: Path, *files: bytes) -> list[str]:
    paths = [folder / f"{number}.pcap" for number in range(len(files))]
    for path, data in zip(paths, files, strict=True):
        path.write_bytes(data)
    return [str(path) for path in paths]


def only(plans: list[PlacePlan]) -> PlacePlan:
    (plan,) = plans
    return plan


@pytest.mark.parametrize("clock", [0, -40 * MS, 500 * SECOND])
@pytest.mark.parametrize("is_reversed", [False, True])
def test_two_ends_of_a_conversation(tmp_path: Path, clock: int, is_reversed: bool) -> None:
    near, far = written(tmp_path, *both_ends().poll(100).captures(clock, 20e-6))
    plan = only(plan_places([far, near] if is_reversed else [near, far], PORTS))
    assert [file.path for file in plan.files] == [near, far]
    assert [file.packets for file in plan.files] == [200, 200]
    assert len(plan.shared) == 1
    assert abs(plan.clock.offset_at(START + clock) - clock) <= plan.clock.error + US


def test_files_of_a_ring_are_not_the_same(tmp_path: Path) -> None:
    packets = both_ends().poll(200).near.packets
    files = [pcap(packets[start : start + 100], nanoseconds=True) for start in range(0, 400, 100)]
    assert plan_places(written(tmp_path, *files), PORTS) == []


def test_each_file_of_a_ring_is_read_only_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packets = both_ends().poll(200).near.packets
    files = [pcap(packets[start : start + 20], nanoseconds=True) for start in range(0, 400, 20)]
    paths = written(tmp_path, *files)
    opened: Counter[str] = Counter()

    def open_counted(path: str) -> CaptureFile:
        opened[path] += 1
        return open_capture(path)

    monkeypatch.setattr(place_plan, "open_capture", open_counted)
    assert plan_places(paths, PORTS) == []
    assert set(opened) == set(paths)
    assert max(opened.values()) == 2  # once for the sample, once for the time of the last packet


def test_a_program_that_runs_again_is_another_conversation(tmp_path: Path) -> None:
    first = both_ends().poll(100).near.packets
    again = Datagrams(client=CLIENT._replace(port=50009))
    second = TwoPlaces(again, Datagrams(), 0).poll(100, START + 3600 * SECOND).near.packets
    assert plan_places(written(tmp_path, *(pcap(each) for each in (first, second))), PORTS) == []


def test_a_capture_that_begins_much_later(tmp_path: Path) -> None:
    places = both_ends().poll(2500)
    places.far.packets = [packet for packet in places.far.packets if packet.time > START + 110 * SECOND]
    paths = written(tmp_path, *places.captures(3 * MS))
    plan = only(plan_places(paths, PORTS))
    assert [file.path for file in plan.files] == paths
    assert only(plan_places(paths[::-1], PORTS)).files == plan.files


def test_a_conversation_that_one_file_lacks_is_not_shared(tmp_path: Path) -> None:
    places = both_ends().poll(50)
    other = Datagrams(server=SERVER._replace(ip="192.168.0.2"))
    places.near.packets += TwoPlaces(other, Datagrams(), 0).poll(50, START + MS).near.packets
    plan = only(plan_places(written(tmp_path, *places.captures()), PORTS))
    assert [near[1].host for near, _ in plan.shared] == ["192.168.0.1"]


def test_both_legs_of_a_proxy_in_two_files(tmp_path: Path) -> None:
    legs = TwoPlaces(Datagrams(CLIENT, PROXY_NEAR), Datagrams(PROXY_FAR, SERVER), 200 * US).poll(50)
    plan = only(plan_places(written(tmp_path, *legs.captures(7 * MS)), PORTS))
    ((near, far),) = plan.shared
    assert (near[1].port, far[1].port) == (5008, 5007)


def test_files_that_cannot_be_read_are_in_no_pair(tmp_path: Path) -> None:
    near, far = written(tmp_path, *both_ends().poll(20).captures())
    missing, text = str(tmp_path / "missing"), tmp_path / "text"
    text.write_text("no capture")
    assert len(plan_places([missing, near, str(text), far], PORTS)) == 1
