"""Layouts: a frame decoded by the form it shares is the frame decoded on its own."""

from __future__ import annotations

import struct
from unittest import mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.protocol.codec import frame_template
from bcapscope.protocol.codec.frame import Frame, Framing, encode_frame
from bcapscope.protocol.codec.frame_content import FrameContent
from bcapscope.protocol.codec.frame_template import (
    FrameTemplate,
    FrameTemplates,
    number_count,
    number_counts,
    numbers_of_arguments,
)
from bcapscope.protocol.codec.variant import ARRAY, VT, Variant
from tests.frames import ARGUMENT_IDS, ARGUMENTS, DAMAGED, FRAMES, ArgumentPair
from tests.fuzz.targets import check_frame
from tests.strategies import frames, mutated_frames, variants


class _DecodedInFull(Exception):
    """No template was known."""


def learnt(templates: FrameTemplates, raw: bytes) -> bool:
    """Return whether a template of the frame is known; learn nothing."""
    with mock.patch.object(frame_template, "FrameContent", side_effect=_DecodedInFull):
        try:
            return isinstance(templates.decode(raw), tuple)
        except _DecodedInFull:
            return False


def renumbered(raw: bytes) -> bytes:
    """Change every number of a sound frame, its serial and its reserved field."""
    data = bytearray(raw)
    data[5:9] = b"\x21\x43\x65\x87"
    for start, code, count in FrameContent(raw).number_spans:
        width = count * struct.calcsize("<" + code)
        data[start : start + width] = bytes(byte ^ 0x35 for byte in data[start : start + width])
    return bytes(data)


@pytest.mark.parametrize("pair", ARGUMENTS, ids=ARGUMENT_IDS)
def test_a_second_frame_of_one_form_needs_no_decoding(pair: ArgumentPair) -> None:
    templates = FrameTemplates()
    first = Frame(encode_frame(1, 0, 64, [pair.variant]), None, templates)
    second = Frame(renumbered(first.raw), None, templates)
    assert not learnt(templates, second.raw)
    assert first.problems == ()
    found = second.template_match
    assert found is not None
    assert first.template_match is not None
    assert found[0] is first.template_match[0]
    assert repr(second.arguments) == repr(FrameContent(second.raw).arguments)
    check_frame(second)


def test_frames_of_another_function_string_or_count_have_another_layout() -> None:
    templates = FrameTemplates()
    made = [
        encode_frame(1, 0, 64, [Variant(VT.BSTR, "slvMove")]),
        encode_frame(1, 0, 63, [Variant(VT.BSTR, "slvMove")]),
        encode_frame(1, 0, 64, [Variant(VT.BSTR, "slvmove")]),
        encode_frame(1, 0, 64, [Variant(VT.BOOL, True)]),
        encode_frame(1, 0, 64, [Variant(VT.BOOL, False)]),
        encode_frame(1, 0, 64, [Variant(VT.EMPTY, None, 0)]),
        encode_frame(1, 0, 64, [Variant(VT.EMPTY, None, 1)]),
    ]
    found = [Frame(raw, None, templates).template_match for raw in made]
    assert len({id(pair[0]) for pair in found if pair is not None}) == len(made)


def test_a_handle_before_other_arguments_belongs_to_the_form() -> None:
    templates = FrameTemplates()
    made = [encode_frame(1, 0, 64, [Variant(VT.I4, handle), Variant(VT.I2, 5)]) for handle in (1, 2)]
    one, two = (Frame(raw, None, templates).template_match for raw in made)
    assert one is not None
    assert two is not None
    assert one[0] is not two[0]
    assert one[1] == two[1] == (5,)
    assert numbers_of_arguments(Frame(made[0], None, templates).arguments) == (5,)


def test_numbers_between_texts_are_put_in_their_places() -> None:
    parts = (
        Variant.array(VT.R8, (1.0, 2.0)),
        Variant(VT.BSTR, "@P"),
        Variant(VT.BOOL, True),
        Variant.array(VT.VARIANT, (Variant(VT.BSTR, "x"), Variant(VT.I4, 7))),
        Variant.array(VT.UI1, b"\x01\x02"),
    )
    raw = encode_frame(1, 0, 64, [Variant(VT.I4, 1), Variant.array(VT.VARIANT, parts)])
    templates = FrameTemplates()
    assert Frame(raw, None, templates).problems == ()
    other = renumbered(raw)[:15] + raw[15:29] + renumbered(raw)[29:]
    assert learnt(templates, other)
    assert repr(Frame(other, None, templates).arguments) == repr(FrameContent(other).arguments)


def test_a_template_is_learnt_from_a_plain_frame_without_problems() -> None:
    for pair in FRAMES:
        template = FrameTemplate.learn(FrameContent(pair.data))
        assert (template is not None) is (pair.framing is Framing.PLAIN)
        if template is not None:
            assert template.fixed_parts(pair.data) == template.expected_parts
    for sample in DAMAGED:
        assert FrameTemplate.learn(FrameContent(sample.data)) is None


def test_the_last_two_frames_without_a_template_are_not_decoded_again() -> None:
    templates = FrameTemplates()
    first, second, third = (sample.data for sample in DAMAGED[:3])
    one, two, three = (templates.decode(raw) for raw in (first, second, third))
    assert templates.decode(third) is three
    assert templates.decode(second) is two
    assert templates.decode(first) is not one


def test_damaged_frames_teach_nothing() -> None:
    templates = FrameTemplates()
    for sample in DAMAGED:
        frame = Frame(sample.data, None, templates)
        assert frame.problems
        assert frame.template_match is None
        assert not learnt(templates, sample.data)


def test_only_plain_frames_are_learnt_and_none_that_is_long() -> None:
    templates = FrameTemplates()
    for pair in FRAMES:
        assert Frame(pair.data, None, templates).problems == ()
        assert learnt(templates, pair.data) is (pair.framing is Framing.PLAIN)
    for size in (frame_template.LARGEST_TEMPLATE_FRAME, frame_template.LARGEST_TEMPLATE_FRAME + 1):
        raw = encode_frame(1, 0, 2, [Variant.array(VT.UI1, bytes(size - 26))])
        assert len(raw) == size
        assert Frame(raw, None, templates).problems == ()
        assert learnt(templates, raw) is (size == frame_template.LARGEST_TEMPLATE_FRAME)


def test_a_learnt_frame_with_any_byte_changed_is_judged_afresh() -> None:
    templates = FrameTemplates()
    plain = [pair.data for pair in FRAMES if pair.framing is Framing.PLAIN]
    for raw in plain:
        assert Frame(raw, None, templates).problems == ()
    for raw in plain:
        for spot in range(len(raw)):
            for change in (0x01, 0x04, 0x20, 0x80, 0xFF):
                check_frame(
                    Frame(raw[:spot] + bytes((raw[spot] ^ change,)) + raw[spot + 1 :], None, templates)
                )
    for raw in plain:
        check_frame(Frame(raw, None, templates))


def test_a_learnt_frame_cut_or_lengthened_is_judged_afresh() -> None:
    templates = FrameTemplates()
    for pair in FRAMES:
        Frame(pair.data, None, templates).problems  # noqa: B018 - learns it
        for end in range(15, len(pair.data)):
            check_frame(Frame(pair.data[:end], None, templates))
            check_frame(Frame(pair.data[:end] + b"\x04", None, templates))
        check_frame(Frame(pair.data + b"\x04", None, templates))


def test_one_length_keeps_several_shapes_and_forgets_the_oldest(monkeypatch: pytest.MonkeyPatch) -> None:
    templates = FrameTemplates()
    monkeypatch.setattr(frame_template, "MAX_SHAPES_PER_LENGTH", 2)
    same_length = [
        encode_frame(1, 0, 1, [Variant(VT.I8, 1)]),
        encode_frame(1, 0, 1, [Variant.array(VT.I4, (1, 2))]),
        encode_frame(1, 0, 1, [Variant(VT.BSTR, "ab")]),
    ]
    assert len({len(raw) for raw in same_length}) == 1
    for raw in same_length:
        assert Frame(raw, None, templates).problems == ()
    assert [learnt(templates, raw) for raw in same_length] == [False, True, True]
    for raw in same_length:
        check_frame(Frame(raw, None, templates))


def test_all_are_forgotten_when_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    templates = FrameTemplates()
    monkeypatch.setattr(frame_template, "MAX_TEMPLATES", 3)
    made = [encode_frame(1, 0, code, [Variant(VT.I4, code)]) for code in range(10)]
    for place, raw in enumerate(made):
        assert Frame(raw, None, templates).template_match is not None
        assert [learnt(templates, each) for each in made[: place + 1]].count(True) == place % 3 + 1
    assert [learnt(templates, raw) for raw in made[-2:]] == [False, True]
    for raw in made:
        check_frame(Frame(raw, None, templates))


@given(st.lists(frames() | mutated_frames(), max_size=8))
def test_the_same_with_and_without_layouts(raws: list[bytes]) -> None:
    templates = FrameTemplates()
    for raw in raws + raws:
        if len(raw) >= 15:
            check_frame(Frame(raw, None, templates))


@given(st.lists(variants(), max_size=4))
def test_numbers_taken_out_go_in_again(values: list[Variant]) -> None:
    templates = FrameTemplates()
    frame = Frame(encode_frame(1, 0, 64, values), None, templates)
    found = frame.template_match
    if found is not None:
        layout, numbers = found
        assert repr(numbers_of_arguments(frame.arguments)) == repr(numbers)
        assert repr(layout.fill_arguments(numbers)) == repr(frame.arguments)
    assert len(numbers_of_arguments(frame.arguments)) == sum(number_counts(frame.arguments))


def test_counts_the_numbers_of_a_value() -> None:
    assert number_count(Variant(VT.I4, 1)) == 1
    assert number_count(Variant(VT.BOOL, True)) == 0
    assert number_count(Variant(VT.BSTR, "A")) == 0
    assert number_count(Variant(ARRAY | VT.UI1, b"abc", 3)) == 1
    assert number_count(Variant(ARRAY | VT.UI1, b"", 0)) == 0
    assert number_count(Variant(ARRAY | VT.R8, (1.0, 2.0), 2)) == 2
    assert number_count(Variant(ARRAY | VT.VARIANT, (Variant(VT.I2, 1), Variant(VT.BSTR, "")), 2)) == 1
    assert number_count(Variant(VT.I4, None)) == 0
