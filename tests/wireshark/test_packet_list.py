"""What the packet list shows, with and without the tree, on any port."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bcapscope.protocol.codec.frame import encode_frame
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.wireshark.plugin_folder import coloring_rules_text
from tests import frames
from tests.bench.traffic import write as write_traffic
from tests.cli.run import CAPTURES
from tests.wireshark.packets import tcp_packets, udp_packet, write_capture
from tests.wireshark.tshark import dissected, needs_tshark, tshark

pytestmark = needs_tshark

REQUEST, REPLY = encode_frame(5, 0, 1, [Variant(VT.BSTR, ",WDT=400")]), encode_frame(5, 0, 0)


def _infos(script: Path, capture: Path, *options: str) -> list[str]:
    """Return the Info column."""
    columns = ("-o", 'gui.column.format:"Info","%i"')
    return [line.strip() for line in tshark(script, capture, *columns, *options).splitlines()]


def test_the_info_column_is_readable(script: Path) -> None:
    assert _infos(script, CAPTURES / "retry-story.pcapng")[:5] == [
        "Request 1232 Robot_Execute slvMove",
        "Retry 1233 of 1232 Robot_Execute slvMove",
        "Retry 1234 of 1232 Robot_Execute slvMove",
        "Retry 1235 of 1232 Robot_Execute slvMove",
        "Reply 1233 S_OK to Robot_Execute slvMove",
    ]


def test_the_info_column_gives_the_meaning_of_a_failure(script: Path) -> None:
    infos = _infos(script, CAPTURES / "slave-mode-lost.pcapng")
    assert infos[65] == "Reply 433 0x83500121 to Robot_Execute slvMove (slvMove while slave mode is off)"
    assert infos[61] == "Reply 431 S_OK to Robot_Execute slvMove"


def test_the_tree_shows_a_result_with_its_meaning(script: Path) -> None:
    lines = tshark(script, CAPTURES / "slave-mode-lost.pcapng", "-O", "bcap").splitlines()
    results = {line.strip() for line in lines if line.startswith("    Result: ")}
    assert "Result: 0x00000000 S_OK: done" in results
    assert "Result: 0x83500121: slvMove while slave mode is off" in results


def test_the_tree_shows_the_numbers_of_an_argument_in_one_line(script: Path) -> None:
    lines = tshark(script, CAPTURES / "slave-session.pcapng", "-O", "bcap").splitlines()
    arguments = {line.strip() for line in lines if re.match(r"    \w+: VT_", line)}
    assert "vntParam: VT_R8|VT_ARRAY [8] 0, 0, 90, 0, 90, 0, 0, 0" in arguments
    fractions = "0.00055, 0.00034, 90.0005, -0.00041, 89.9995, 0.00083, 0, 0"
    assert f"vntParam: VT_R8|VT_ARRAY [8] {fractions}" in arguments
    assert "hRobot: VT_I4 2" in arguments
    assert "vntParam: VT_I4|VT_ARRAY [2] 18, 1" in arguments


def test_the_tree_shows_the_first_of_many_numbers(script: Path, tmp_path: Path) -> None:
    many = encode_frame(5, 0, 0, [Variant.array(VT.R4, (0.1,) * 13)])
    capture = write_capture(tmp_path / "a.pcap", [udp_packet(False, many)])
    label = f"pVal: VT_R4|VT_ARRAY [13] {'0.1, ' * 12}…"
    assert label in {line.strip() for line in tshark(script, capture, "-O", "bcap").splitlines()}


def _headings(script: Path, capture: Path) -> list[str]:
    lines = tshark(script, capture, "-O", "bcap").splitlines()
    return [line.removeprefix("DENSO b-CAP, ") for line in lines if line.startswith("DENSO b-CAP, ")]


def test_the_packet_list_is_the_same_without_tree(script: Path, tmp_path: Path) -> None:
    capture = tmp_path / "traffic.pcap"
    write_traffic(capture, 2_000)
    assert _infos(script, capture) == _headings(script, capture)


def test_changed_bytes_of_a_known_frame_are_noticed_without_tree(script: Path, tmp_path: Path) -> None:
    sound = max((pair.data for pair in frames.FRAMES if len(pair.data) < 200), key=len)
    damaged = [sound[:at] + bytes([sound[at] ^ 0x55]) + sound[at + 1 :] for at in range(1, len(sound))]
    packets = [udp_packet(True, each) for changed in damaged for each in (sound, changed)]
    capture = write_capture(tmp_path / "damaged.pcap", packets)
    infos = _infos(script, capture)
    assert infos == _headings(script, capture)
    assert any("!!" in info for info in infos)


@pytest.mark.parametrize("port", [5007, 15007])
def test_other_ports_are_recognised(port: int, script: Path, tmp_path: Path) -> None:
    packets = [
        udp_packet(True, REQUEST, port),
        udp_packet(False, REPLY, port),
        *tcp_packets(True, [REQUEST], 40_000, port),
        *tcp_packets(False, [REPLY], 40_000, port)[2:],
    ]
    shown = dissected(script, write_capture(tmp_path / "a.pcap", packets))
    assert [each["kind"] for each in shown] == ["request", "response", "request", "response"]
    assert {each["function"] for each in shown} == {"Service_Start"}


def test_a_preference_names_other_ports(script: Path, tmp_path: Path) -> None:
    # Bytes that no one would recognise as b-CAP
    capture = write_capture(tmp_path / "a.pcap", [udp_packet(True, b"\x02abc", 6001)])
    assert dissected(script, capture) == []
    (shown,) = dissected(script, capture, "-o", "bcap.ports:6000-6002")
    assert shown["kind"] == "malformed"


def test_other_protocols_on_other_ports_are_left_alone(script: Path, tmp_path: Path) -> None:
    almost = REQUEST[:-1] + b"\x05"
    packets = [udp_packet(True, almost, 6001), *tcp_packets(True, [almost], 40_000, 6001)]
    assert dissected(script, write_capture(tmp_path / "a.pcap", packets)) == []


def test_display_filters_find_values_and_damage(script: Path) -> None:
    def count(capture: str, display_filter: str) -> int:
        return len(tshark(script, CAPTURES / capture, "-Y", display_filter).splitlines())

    assert count("slave-mode-lost.pcapng", 'bcap.command == "slvMove" && bcap.kind == "request"') == 33
    assert count("slave-mode-lost.pcapng", "bcap.hresult == 0x83500121") > 0
    assert count("slave-mode-lost.pcapng", "bcap.slave_mode == 0x202") > 0
    assert count("malformed.pcapng", "bcap.damaged") == count("malformed.pcapng", "bcap.problems") > 20
    assert count("retry-story.pcapng", "bcap.retry_of") > 0


def test_the_coloring_rules_apply(script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "colorfilters").write_text(coloring_rules_text(), encoding="utf-8")
    monkeypatch.setenv("WIRESHARK_CONFIG_DIR", str(tmp_path))
    options = ("--color", "-T", "fields", "-e", "frame.coloring_rule.name")
    names = {*tshark(script, CAPTURES / "slave-mode-lost.pcapng", *options).split("\n")}
    assert {"b-CAP failed", "b-CAP reply", "b-CAP request"} <= names


PAGE = (CAPTURES.parent / "docs" / "wireshark.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("display_filter", re.findall(r"(?m)^\| Show [^|]* \| `([^`]*)` \|$", PAGE))
def test_the_display_filters_of_the_page_find_packets(display_filter: str, script: Path) -> None:
    names = ("slave-session.pcapng", "slave-mode-lost.pcapng", "retry-story.pcapng", "malformed.pcapng")
    assert any(tshark(script, CAPTURES / name, "-Y", display_filter) for name in names)


def test_the_page_shows_real_lines_and_fields(script: Path) -> None:
    (lines,) = re.findall(r"(?ms)^```text\n(.*?)^```$", PAGE)
    names = ("retry-story.pcapng", "slave-mode-lost.pcapng", "malformed.pcapng")
    shown = {info for name in names for info in _infos(script, CAPTURES / name)}
    assert set(lines.splitlines()) <= shown
    fields = {name for name in re.findall(r"`(bcap\.[a-z0-9_.]+)`", PAGE) if name != "bcap.ports"}
    assert len(fields) > 20
    condition = " || ".join(sorted(fields))
    assert tshark(script, CAPTURES / "exchanges.pcap", "-Y", condition)
