"""Write the Wireshark dissector: the protocol's tables as Lua code, then the parts in the folder `lua`."""

from __future__ import annotations

import re
import sys
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files

from bcapscope import __version__
from bcapscope.capture.role_detection import BCAP_PORTS, SENT_TYPES
from bcapscope.messages import ENGLISH_WORDS, Message
from bcapscope.protocol.codec import arguments, frame_content, stream_splitter, variant
from bcapscope.protocol.codec.variant import ARRAY, VT, vt_name
from bcapscope.protocol.slave_mode.modes import MODES
from bcapscope.protocol.tables import hresult
from bcapscope.protocol.tables.command_catalogue import COMMAND_FUNCTIONS
from bcapscope.protocol.tables.function_table import FUNCTIONS
from bcapscope.render.escape import printable
from bcapscope.traffic.call_kind import LONGEST_NAME
from bcapscope.traffic.pairing_windows import COPIES_WITHIN_NS, RETRY_WITHIN_NS
from bcapscope.traffic.recent_serials import MAX_SERIALS
from bcapscope.traffic.serial_table import MAX_REUSED

PARTS = ("inflate", "decoder", "splitter", "dissector")  # a part can use what earlier parts export

_EXPORTS = re.compile(r"(?m)^-- Exports: (.+)$")

_TEXT_ID = re.compile(r'"((?:problem|hresult)\.[a-z0-9.-]*[a-z0-9])"')

_HIDDEN_CATEGORIES = ("Cc", "Cf", "Zl", "Zp")  # characters that can control a terminal or hide text

_HEAD = """\
-- DENSO b-CAP for Wireshark, Lua 5.2 to 5.4.
--
-- Written by bcapscope {version} from its tables of the protocol (`bcapscope wireshark --install`).
-- License: GPL-2.0-or-later.

local byte, sub, floor = string.byte, string.sub, math.floor
"""


def dissector_text() -> str:
    folder = files(__package__) / "lua"
    parts = [(folder / f"{part}.lua").read_text(encoding="utf-8") for part in PARTS]
    return "\n".join((_HEAD.format(version=__version__), _tables(parts), *map(_block, parts)))


def _block(part: str) -> str:
    """Put a part into its own Lua block, because one Lua function can have at most 200 local names."""
    exports = _EXPORTS.search(part)
    declared = f"local {exports[1]}\n" if exports else ""
    return f"{declared}do\n\n{part}\nend\n"


def _tables(parts: Iterable[str]) -> str:
    """Return all tables as Lua code. Leave out texts whose ids do not occur in `parts`."""
    tables = {**_limits(), **_types(), **_functions(), **_results(), "TEXTS": _texts(parts)}
    tables["COUNTS"] = {
        unit: [ENGLISH_WORDS.plural(f"count.{unit}", number).replace(str(number), "{n}") for number in (1, 2)]
        for unit in ("byte", "element")
    }
    tables["SLAVE_MODES"] = _slave_modes()
    tables["UNPRINTABLE"] = {
        char: printable(char)
        for char in map(chr, range(0x80, sys.maxunicode + 1))
        if unicodedata.category(char) in _HIDDEN_CATEGORIES
    }
    return "\n".join(f"local {name} = {_lua(value)}" for name, value in tables.items()) + "\n"


def _limits() -> dict[str, object]:
    return {
        "DEFAULT_PORT": ",".join(map(str, sorted(BCAP_PORTS))),
        "SOH": frame_content.SOH,
        "EOT": frame_content.EOT,
        "HEADER_SIZE": frame_content.HEADER_SIZE,
        "SMALLEST_FRAME": frame_content.SMALLEST_FRAME,
        "LARGEST_FRAME": frame_content.LARGEST_FRAME,
        "LARGEST_UNPACKED": frame_content.LARGEST_UNPACKED,
        "LARGEST_UNCONFIRMED": stream_splitter.LARGEST_UNCONFIRMED,
        "LARGEST_GARBAGE": stream_splitter.LARGEST_GARBAGE,
        "MAX_RESYNC_ARGUMENTS": stream_splitter.MAX_RESYNC_ARGUMENTS,
        "SMALLEST_ARGUMENT": arguments.SMALLEST_ARGUMENT,
        "MAX_NUMBERS": arguments.MAX_NUMBERS,
        "MAX_VALUES": arguments.MAX_VALUES,
        "MAX_PROBLEMS": arguments.MAX_PROBLEMS,
        "MAX_NESTING": variant.MAX_NESTING,
        "MAX_SERIALS": MAX_SERIALS,
        "MAX_REUSED": MAX_REUSED,
        "LONGEST_NAME": LONGEST_NAME,
        "COPIES_WITHIN": COPIES_WITHIN_NS / 1e9,
        "RETRY_WITHIN": RETRY_WITHIN_NS / 1e9,
        "S_EXECUTING": hresult.S_EXECUTING,
    }


def _types() -> dict[str, object]:
    names = {int(vt): vt_name(vt) for vt in VT}
    constants = {vt.name: int(vt) for vt in (VT.NULL, VT.BSTR, VT.BOOL, VT.VARIANT, VT.UI1, VT.CY, VT.ERROR)}
    return {
        "ARRAY": ARRAY,
        **constants,
        "WIDTHS": {int(vt): width for vt, width in variant.NUMBER_WIDTHS.items()},
        "TYPE_NAMES": names,
        "TYPE_NAMES_WITH_ARRAYS": names | {ARRAY | vt: vt_name(ARRAY | vt) for vt in names},
        "SENT_TYPES": {name: dict.fromkeys(map(int, types), True) for name, types in SENT_TYPES.items()},
    }


def _functions() -> dict[str, object]:
    functions = FUNCTIONS.values()
    return {
        "FUNCTION_NAMES": {each.id: each.name for each in functions},
        "PARAMS": {each.id: [[param.name, param.type] for param in each.params] for each in functions},
        "RESULT_NAMES": {each.id: each.result_name for each in functions if each.result_name},
        "COMMAND_FUNCTIONS": dict.fromkeys(sorted(COMMAND_FUNCTIONS), True),
    }


def _results() -> dict[str, object]:
    return {
        "RESULTS": {
            code: [hresult.hresult_name(code), info.text] for code, info in hresult.LISTED_RESULTS.items()
        },
        "RESULT_RANGES": [[first, last, row["text"]] for first, last, row in hresult.RESULT_RANGES],
        "RC7_RESULTS": {low: info.text for low, info in hresult.RC7_RESULTS.items()},
    }


def _slave_modes() -> dict[int, str]:
    texts: dict[int, list[str]] = {}
    for mode in MODES:
        texts.setdefault(mode.value, []).append(f"{mode.generation}: {mode.text}")
    return {value: " / ".join(found) for value, found in texts.items()}


def _texts(parts: Iterable[str]) -> dict[str, str]:
    used = {found for part in parts for found in _TEXT_ID.findall(part)}
    used |= {f"hresult.level.{level}" for level in hresult.LEVELS}
    used |= {f"hresult.part.{part}" for part in hresult.SUBSYSTEMS}
    return {id: str(Message(id)) for id in sorted(used)}


def _lua(value: object) -> str:
    if isinstance(value, str):
        return '"' + "".join(map(_lua_char, value)) + '"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        lines = "".join(f"    [{_lua(key)}] = {_lua(each)},\n" for key, each in value.items())
        return f"{{\n{lines}}}"
    if isinstance(value, Sequence):
        return f"{{ {', '.join(map(_lua, value))} }}"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _lua_char(char: str) -> str:
    if char.isprintable():
        return f"\\{char}" if char in '"\\' else char
    return "".join(f"\\{byte:03d}" for byte in char.encode())
