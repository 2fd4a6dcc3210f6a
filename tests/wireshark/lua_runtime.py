"""The parts of the dissector that use nothing of Wireshark, in each Lua that Wireshark uses."""

from __future__ import annotations

from typing import Any

import pytest

from bcapscope.wireshark.dissector import dissector_text

VERSIONS = ("lua52", "lua53", "lua54")


def lua_runtime(version: str) -> Any:
    """Return a Lua interpreter; skip the test if it is not installed."""
    lua = pytest.importorskip(f"lupa.{version}", reason=f"lupa with {version} is not installed")
    return lua.LuaRuntime(encoding=None)


def dissector_functions(version: str, code: str) -> Any:
    """Return what `code` returns, which can use the decoder and the splitter of the dissector."""
    before_wireshark = dissector_text().partition("-- The dissector: fields")[0].rpartition("do\n")[0]
    return lua_runtime(version).execute((before_wireshark + code).encode())
