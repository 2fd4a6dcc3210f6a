"""Frames and calls as tables."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import bcapscope
from tests.capture.packets import enhanced, from_client, interface, request, section

ROOT = Path(__file__).parent.parent.parent
SESSION = str(ROOT / "captures" / "slave-session.pcapng")
MALFORMED = str(ROOT / "captures" / "malformed.pcapng")
PAGE = (ROOT / "docs" / "python.md").read_text("utf-8")


def documented(kind: str) -> list[str]:
    """Return the names of the columns on the page."""
    table = PAGE.partition(f"| Column of {kind} |")[2].partition("\n\n")[0]
    return [name for line in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", line.split("|")[1])]


@pytest.mark.parametrize("kind", ["frames", "calls"])
@pytest.mark.parametrize("path", [SESSION, MALFORMED])
def test_both_libraries_get_the_documented_columns(path: str, kind: str) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    records = getattr(bcapscope.open(path), kind)
    frame, table = records.to_pandas(), records.to_arrow()
    assert sorted(frame.columns) == sorted(table.column_names) == sorted(documented(kind))
    assert len(frame) == table.num_rows == len(list(records))


def test_values_and_units_in_pandas() -> None:
    pandas = pytest.importorskip("pandas")
    capture = bcapscope.open(SESSION, filter="command == slvMove")
    (*_, call), table = capture.calls, capture.calls.to_pandas()
    row = table.iloc[-1]
    assert row["call"] == call.number
    assert row["started"] == pandas.Timestamp(call.request.time, tz="UTC")
    assert row["started"].value == call.request.time
    assert call.latency is not None
    assert row["latency_ms"] == call.latency / 1e6
    assert row["request_numbers"] == list(call.request.item.variants[2].value)  # type: ignore[arg-type]
    assert str(table["hresult"].dtype) == "Int64"


def test_values_and_units_in_arrow() -> None:
    pyarrow = pytest.importorskip("pyarrow")
    capture = bcapscope.open(SESSION)
    table = capture.frames.to_arrow()
    assert table.schema.field("time").type == pyarrow.timestamp("ns", "UTC")
    first = next(iter(capture.frames))
    assert table["time"].cast(pyarrow.int64())[0].as_py() == first.time
    assert table["function"][0].as_py() == "Service_Start"
    assert table["hresult"][0].as_py() is None


@pytest.mark.parametrize("kind", ["frames", "calls"])
def test_an_empty_table_has_the_types_of_a_full_one(kind: str) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    none = getattr(bcapscope.open(SESSION, filter="function_id == 99"), kind)
    everything = getattr(bcapscope.open(SESSION), kind)
    assert none.to_pandas().dtypes.equals(everything.to_pandas().dtypes)
    assert none.to_arrow().schema == everything.to_arrow().schema
    assert none.to_arrow().num_rows == 0


def test_a_hostile_time_and_text_are_no_error(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    hostile = bcapscope.encode("Robot_Execute", [2, "x\ud800\x00", None])
    path = tmp_path / "hostile.pcapng"
    frames = [from_client(request(1)), from_client(hostile)]
    path.write_bytes(section() + interface() + b"".join(enhanced(data, (1 << 64) - 1) for data in frames))
    for kind in ("frames", "calls"):
        records = getattr(bcapscope.open(path), kind)
        time = "time" if kind == "frames" else "started"
        assert records.to_pandas()[time].isna().all()
        assert records.to_arrow()[time].null_count == len(list(records)) == 2
        assert records.to_arrow()["command"][1].as_py() == "x?\x00"


@pytest.mark.parametrize(("package", "method"), [("pandas", "to_pandas"), ("pyarrow", "to_arrow")])
def test_a_missing_package_is_named_with_its_extra(package: str, method: str) -> None:
    program = (
        f"import sys; sys.modules[{package!r}] = None; import bcapscope\n"
        f"try: bcapscope.open({SESSION!r}).frames.{method}()\n"
        "except bcapscope.MissingExtraError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    extra = method.removeprefix("to_")
    assert done.stdout == (f"{package} is not installed. Install it with: pip install 'bcapscope[{extra}]'\n")
