"""A frame as a tree and as bytes, linked both ways."""

from __future__ import annotations

import pytest
from textual.pilot import Pilot

from bcapscope.protocol.codec.frame import Malformed, encode_frame, parse_datagram
from bcapscope.protocol.codec.variant import VT, Variant
from bcapscope.render.frame_tree import frame_sections
from bcapscope.tui.widgets.packet_view import FieldTree, HexView, PacketView, _byte_at, width_for
from tests.render.scenes import ROBOT, observe, scenes
from tests.tui.marks import strip_styles
from tests.tui.pilot import shown
from tests.tui.widgets.stage import on_stage, scope

MOVE = encode_frame(5, 0, 64, (ROBOT, Variant(VT.BSTR, "slvMove"), Variant.array(VT.R8, (1.0, 2.0, 3.0))))


def parts(pilot: Pilot[None]) -> tuple[PacketView, FieldTree, HexView]:
    view = pilot.app.screen.query_one(PacketView)
    return view, view.query_one(FieldTree), view.query_one(HexView)


def show(pilot: Pilot[None], raw: bytes) -> tuple[PacketView, FieldTree, HexView]:
    view, tree, bytes_ = parts(pilot)
    view.show_packet(observe(parse_datagram(raw)[0]))
    return view, tree, bytes_


def here(tree: FieldTree) -> str:
    return " ".join(strip_styles(tree.line(tree.cursor)).split()[:3])


def test_every_field_lights_its_bytes_and_every_byte_its_field() -> None:
    async def act(pilot: Pilot[None]) -> None:
        _, tree, view = show(pilot, MOVE)
        tree.focus()
        for _ in range(tree.count - 1):
            await pilot.press("down")
            _, row = tree._entries[tree._visible[tree.cursor]]
            assert row is not None
            assert view._highlighted == (0, row.start, row.stop)
        view.focus()
        await pilot.press("home")
        for offset in range(1, len(MOVE)):
            await pilot.press("right")
            assert view._cursor_byte == (0, offset)
            _, start, stop = view._highlighted
            assert start <= offset < stop
        assert here(tree).startswith(str(len(MOVE) - 1))

    on_stage(PacketView, act, (120, 40))


def test_branches_fold_and_unfold_and_open_for_the_byte_in_them() -> None:
    async def act(pilot: Pilot[None]) -> None:
        _, tree, view = show(pilot, MOVE)
        tree.focus()
        rows = tree.count
        tree.move_cursor_to(6)
        assert here(tree) == "15 ▸ hRobot"
        await pilot.press("right")
        assert here(tree) == "15 ▾ hRobot"
        assert tree.count > rows
        await pilot.press("down", "left")
        assert here(tree) == "15 ▾ hRobot"
        await pilot.press("space")
        assert tree.count == rows
        view.focus()
        await pilot.press("home", *["right"] * 15)
        assert tree.count > rows
        assert here(tree) == "15 length 10"

    on_stage(PacketView, act, (120, 40))


def test_all_elements_are_a_key_away() -> None:
    many = encode_frame(5, 0, 64, (ROBOT, Variant.array(VT.I4, tuple(range(100)))))

    async def act(pilot: Pilot[None]) -> None:
        _, tree, _ = show(pilot, many)
        before = tree.count
        tree.focus()
        await pilot.press("a")
        assert tree.count == before + 100 - 32 - 1
        await pilot.press("a")
        assert tree.count == before

    on_stage(PacketView, act)


@pytest.mark.parametrize("number", range(len(list(scenes()))))
def test_everything_there_is_can_be_shown(number: int) -> None:
    seen, question = list(scenes())[number]

    async def act(pilot: Pilot[None]) -> None:
        view, tree, hexes = parts(pilot)
        view.show_packet(seen, question)
        await pilot.pause()
        assert [strip_styles(tree.line(index)) for index in range(tree.count)]
        hexes.focus()
        await pilot.press("end", "up", "left", "home", "pagedown", "right")
        lines = [strip_styles(hexes.line(index)) for index in range(hexes.count)]
        assert all(line.isprintable() for line in lines)
        bodies = [section.body for section in frame_sections(seen, question)]
        wanted = sum(-(-len(body) // hexes._per_line) for body in bodies) + len(bodies) - 1
        assert hexes.count == wanted
        view.show_packet(None)
        assert (tree.count, hexes.count) == (0, 0)

    on_stage(PacketView, act)


@pytest.mark.parametrize(("width", "per_line"), [(60, 8), (110, 8), (126, 16), (200, 16)])
def test_there_are_as_many_bytes_a_line_as_there_is_room_for(width: int, per_line: int) -> None:
    async def act(pilot: Pilot[None]) -> None:
        _, _, view = show(pilot, MOVE)
        await pilot.pause()
        assert view._per_line == per_line
        assert MOVE[:per_line].hex(" ", 1)[:23] in shown(scope(pilot))

    on_stage(PacketView, act, (width, 24))


@pytest.mark.parametrize("per_line", [8, 16])
def test_a_click_finds_its_byte(per_line: int) -> None:
    view = HexView()
    view._per_line = per_line
    view._sections = frame_sections(observe(Malformed(bytes(range(0x41, 0x41 + per_line)), ())), None)
    line = strip_styles(view._hex_row(0, view._sections[0].body, 0))
    for byte in range(per_line):
        pair = f"{0x41 + byte:02x}"
        assert _byte_at(line.index(pair, 8), per_line) == byte
        assert _byte_at(len(line) - per_line + byte, per_line) == byte
    assert _byte_at(3, per_line) is None
    assert len(line) == width_for(per_line)
