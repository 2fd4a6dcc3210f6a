"""The table of fields that filters ask for."""

from __future__ import annotations

import pytest

from bcapscope.traffic.filter.compiler import compile_filter
from bcapscope.traffic.filter.field_table import FIELD_BY_NAME, FIELDS, FieldType, RecordKind, fields_of


def test_the_table_is_sound() -> None:
    assert len(FIELD_BY_NAME) == len(FIELDS)
    for field in FIELDS:
        assert field.name.islower()
        assert field.name.isidentifier()
        assert field.meaning
        assert not field.meaning.endswith(".")
        assert field.applies_to
        assert field.type is not FieldType.VALUE
        measured = FIELD_BY_NAME[field.getter_name]
        assert (measured.type, measured.applies_to) == (field.type, field.applies_to)


@pytest.mark.parametrize("kind", RecordKind)
def test_every_field_can_stand_alone_and_be_asked_for_presence(kind: RecordKind) -> None:
    for field in fields_of(kind).values():
        compiled = compile_filter(f"{field.name} or {field.name} != null", kind)
        assert compiled.getter_names == {field.getter_name}
        assert compiled.bind({field.getter_name: lambda record: record})(0) is True


def test_what_an_index_leads_to() -> None:
    assert FieldType.NUMBERS.element is FieldType.NUMBER
    assert FieldType.VALUES.element is FieldType.VALUE.element is FieldType.VALUE
    assert FieldType.TEXT.element is None
