"""Write the capture interfaces and their options as lines for Wireshark. The extcap protocol calls these
lines sentences (`man extcap`).
"""

from __future__ import annotations

from collections.abc import Iterator

from bcapscope import __version__
from bcapscope.wireshark.capture_sources import CaptureSource, DialogOption, DialogType

_LINKTYPE_RAW = 101
_UNQUOTABLE = str.maketrans("{}\r\n\t", "()   ")
"""Braces and line ends delimit values and sentences, and the protocol has no way to quote them."""

_FILE_TYPES = "Scenarios (*.yaml *.yml);;All files (*)"


def interface_sentences(sources: dict[str, CaptureSource]) -> Iterator[str]:
    """Yield a sentence with the version of bcapscope, then a sentence for each interface."""
    yield _sentence("extcap", version=__version__, display="b-CAP")
    for source in sources.values():
        yield _sentence("interface", value=source.name, display=source.title)


def link_type_sentences() -> Iterator[str]:
    yield _sentence("dlt", number=_LINKTYPE_RAW, name="LINKTYPE_RAW", display="Raw IP")


def option_sentences(source: CaptureSource) -> Iterator[str]:
    """Yield a sentence for each input of an interface's dialog. If the input is a list, the sentences for its
    values follow.
    """
    for number, option in enumerate(source.options):
        yield _sentence("arg", number=number, **_input(option))
        for value, display in option.choices.items():
            is_default = "true" if value == option.default else "false"
            yield _sentence("value", arg=number, value=value, display=display, default=is_default)


def _input(option: DialogOption) -> dict[str, str]:
    given = {
        "call": option.call,
        "display": option.label,
        "type": option.type.value,
        "default": option.default,
        "tooltip": option.tooltip,
        "placeholder": option.placeholder,
        "range": option.range,
        "required": "true" if option.is_required else "",
    }
    if option.type is DialogType.FILE:
        given |= {"mustexist": "true", "fileext": _FILE_TYPES}
    return {name: value for name, value in given.items() if value}


def _sentence(kind: str, **parts: str | int) -> str:
    return f"{kind} " + "".join(
        f"{{{name}={str(value).translate(_UNQUOTABLE)}}}" for name, value in parts.items()
    )
