"""Write the Wireshark dissector. It consists of the protocol's tables as Lua code, followed by the Lua parts
in the folder `lua`.
"""

from __future__ import annotations

import re
from importlib.resources import files

from bcapscope import __version__
from bcapscope.wireshark.lua_tables import dissector_tables

PARTS = ("inflate", "decoder", "splitter", "dissector")
"""The fixed Lua parts of the dissector, in the order in which the dissector contains them. Each part uses
what the earlier parts export.
"""

_EXPORTS = re.compile(r"(?m)^-- Exports: (.+)$")

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
    return "\n".join((_HEAD.format(version=__version__), dissector_tables(parts), *map(_block, parts)))


def _block(part: str) -> str:
    """Put a part of the dissector into a separate Lua block, and return the block. One Lua function can have
    at most 200 local names.
    """
    exports = _EXPORTS.search(part)
    declared = f"local {exports[1]}\n" if exports else ""
    return f"{declared}do\n\n{part}\nend\n"
