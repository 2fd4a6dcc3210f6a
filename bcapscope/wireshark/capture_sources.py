"""The capture interfaces that bcapscope adds to Wireshark, and the options of these interfaces.

`man extcap` describes the output. When Wireshark starts, Wireshark runs every program in the extcap folder.
This module imports little, so that bcapscope starts fast.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from bcapscope import __version__
from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.simulator.profile import PROFILES
from bcapscope.simulator.scenario_files import bundled_titles

UNSET = "unset"  # the choice in Wireshark's dialog that leaves the option out of the command

_FAULT = re.compile(r"""(?:"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*'|[^;])+""")
"""Pattern of one fault. Semicolons separate faults, except semicolons in quotation marks."""

_NETWORK = re.compile(r"[^\s,]+")


class CaptureOptionError(BcapError):
    """The text of the error names the invalid option."""


class DialogType(StrEnum):
    """Kind of input in Wireshark's dialog; the values are words of the extcap protocol."""

    TEXT = "string"
    NUMBER = "unsigned"
    LIST = "selector"
    FILE = "fileselect"
    SWITCH = "boolflag"


@dataclass(frozen=True, slots=True)
class DialogOption:
    """An input field in Wireshark's dialog that sets an option of a bcapscope command.

    Attributes:
        call: Name of the option that Wireshark passes, such as `--port`.
        placeholder: Example that an empty input field shows.
        choices: Maps each value that you can choose to the text that Wireshark shows.
        range: Smallest and largest number that you can enter; "" for no limits.
        option: Name of the command's option; "" if it is the same as `call`.
        each_value: Pattern of one value, if the input field can contain several values.
    """

    call: str
    label: str
    tooltip: str
    type: DialogType = DialogType.TEXT
    default: str = ""
    placeholder: str = ""
    choices: Mapping[str, str] = field(default_factory=dict)
    range: str = ""
    is_required: bool = False
    option: str = ""
    each_value: re.Pattern[str] | None = None

    def words(self, value: str) -> list[str]:
        if self.type is DialogType.SWITCH:
            return [self.call] if value == "true" else []
        values = [value] if self.each_value is None else self.each_value.findall(value)
        stripped = [each for value in values if (each := value.strip()) not in ("", UNSET)]
        return [word for each in stripped for word in (self.option or self.call, each)]


@dataclass(frozen=True, slots=True)
class CaptureSource:
    """A capture interface in Wireshark. `command` is the bcapscope command that captures the packets."""

    name: str
    title: str
    command: str
    options: tuple[DialogOption, ...]

    def command_words(self, given: Sequence[str]) -> list[str]:
        """Convert the options that Wireshark passes to the words of a bcapscope command line.

        Raises CaptureOptionError if an option is unknown or missing, has no value, or conflicts with another
        option.
        """
        values = self._values(given)
        words, used = [self.command], dict[str, str]()
        for option in self.options:
            added = option.words(values.get(option.call, option.default))
            if option.is_required and not added:
                raise CaptureOptionError(
                    Message("extcap.required", label=option.label, option=option.call, interface=self.title)
                )
            if added and used.setdefault(added[0], option.call) != option.call:
                raise CaptureOptionError(Message("extcap.both", one=used[added[0]], other=option.call))
            words += added
        return words

    def _values(self, given: Sequence[str]) -> dict[str, str]:
        values, rest = dict[str, str](), list(given)
        switches = {option.call: option.type is DialogType.SWITCH for option in self.options}
        while rest:
            call, equals, value = rest.pop(0).partition("=")
            if call not in switches:
                raise CaptureOptionError(Message("extcap.unknown-option", interface=self.name, option=call))
            if switches[call]:
                value = value or "true"
            elif not equals:
                if not rest:
                    raise CaptureOptionError(Message("extcap.no-value", option=call))
                value = rest.pop(0)
            values[call] = value
        return values


_SEED = DialogOption(
    "--seed",
    "Random seed",
    "The same seed and traffic give the same faults. Empty: a new seed each time.",
    placeholder="new each time",
)


def proxy_source() -> CaptureSource:
    return CaptureSource(
        "bcapscope-proxy",
        "b-CAP proxy",
        "proxy",
        (
            DialogOption(
                "--to",
                "Controller",
                "Forward to this controller, HOST:PORT.",
                placeholder="192.168.0.1:5007",
                is_required=True,
            ),
            DialogOption(
                "--listen",
                "Listen on",
                "Accept clients on this address, HOST:PORT. 127.0.0.1 is for clients on this computer only.",
                default="127.0.0.1:5007",
            ),
            DialogOption(
                "--transport",
                "Transport",
                "Listen on this transport.",
                DialogType.LIST,
                default="both",
                choices={"both": "UDP and TCP", "udp": "UDP", "tcp": "TCP"},
            ),
            DialogOption(
                "--allow",
                "Allowed clients",
                "Accept only these addresses or networks, separated by commas. Empty: all.",
                placeholder="all",
                each_value=_NETWORK,
            ),
            DialogOption(
                "--fault",
                "Faults",
                "Inject these faults, separated by semicolons. See `bcapscope proxy --help-faults`.",
                placeholder="loss=5%; delay=3ms if command == slvMove",
                each_value=_FAULT,
            ),
            _SEED,
            DialogOption(
                "--read-only",
                "Read only",
                "Refuse requests that energise or move the robot or change its state. "
                "Stops are always forwarded.",
                DialogType.SWITCH,
                default="false",
            ),
        ),
    )


def simulator_source() -> CaptureSource:
    profiles = {name: f"{name}: {profile.title}" for name, profile in PROFILES.items()}
    scenarios = {name: f"{name}: {title}" for name, title in bundled_titles().items()}
    return CaptureSource(
        "bcapscope-sim",
        "b-CAP simulator",
        "sim",
        (
            DialogOption(
                "--profile",
                "Controller",
                "Simulate this kind of controller.",
                DialogType.LIST,
                default=UNSET,
                choices={UNSET: "As the scenario requires, otherwise rc8"} | profiles,
            ),
            DialogOption(
                "--scenario",
                "Scenario",
                "Begin in the state of this scenario and inject its faults.",
                DialogType.LIST,
                default=UNSET,
                choices={UNSET: "None"} | scenarios,
            ),
            DialogOption(
                "--scenario-file",
                "Scenario file",
                "Play your own scenario from this YAML file.",
                DialogType.FILE,
                option="--scenario",
            ),
            DialogOption(
                "--listen",
                "Listen on",
                "Accept clients on this address. 127.0.0.1 is for clients on this computer only.",
                default="127.0.0.1",
            ),
            DialogOption(
                "--port",
                "Port",
                "Accept clients on this port, UDP and TCP.",
                DialogType.NUMBER,
                default="5007",
                range="1,65535",
            ),
            _SEED,
        ),
    )


def capture_sources() -> dict[str, CaptureSource]:
    return {source.name: source for source in (proxy_source(), simulator_source())}


_LINKTYPE_RAW = 101
_UNQUOTABLE = str.maketrans("{}\r\n\t", "()   ")
"""In extcap, braces enclose a value, and a line end ends a sentence. extcap cannot quote these characters."""

_FILE_TYPES = "Scenarios (*.yaml *.yml);;All files (*)"


def interface_sentences(sources: dict[str, CaptureSource]) -> Iterator[str]:
    yield _sentence("extcap", version=__version__, display="b-CAP")
    for source in sources.values():
        yield _sentence("interface", value=source.name, display=source.title)


def link_type_sentences() -> Iterator[str]:
    yield _sentence("dlt", number=_LINKTYPE_RAW, name="LINKTYPE_RAW", display="Raw IP")


def option_sentences(source: CaptureSource) -> Iterator[str]:
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
