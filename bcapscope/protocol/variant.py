"""Deprecated location of `VT` and `Variant`, for programs that older versions of bcapscope generated."""

import warnings
from typing import Any

from bcapscope.protocol.codec import variant as _variant


def __getattr__(name: str) -> Any:
    value = getattr(_variant, name)
    if not name.startswith("__"):
        text = "bcapscope.protocol.variant is deprecated; import VT and Variant from bcapscope.protocol"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
    return value
