"""Former location of the scapy layer `BCAP`."""

import warnings
from typing import Any


def __getattr__(name: str) -> Any:
    if name != "BCAP":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from bcapscope.scapy_layer import BCAP  # noqa: PLC0415 - loads scapy

    text = "bcapscope.capture.layer is deprecated; import BCAP from bcapscope.scapy_layer"
    warnings.warn(text, DeprecationWarning, stacklevel=2)
    return BCAP
