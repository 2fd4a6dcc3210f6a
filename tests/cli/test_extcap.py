"""``bcapscope extcap``: what it answers when Wireshark asks."""

from __future__ import annotations

import re
from itertools import pairwise

import click
import pytest

from bcapscope.cli.proxy import command as proxy
from bcapscope.cli.sim import command as sim
from bcapscope.simulator.scenario import read_scenario
from bcapscope.simulator.scenario_files import bundled_scenarios, bundled_titles
from bcapscope.wireshark.capture_sources import (
    CaptureOptionError,
    CaptureSource,
    DialogOption,
    DialogType,
    capture_sources,
    option_sentences,
)
from tests.cli.run import run_here

SOURCES = capture_sources()
COMMANDS = {"proxy": proxy, "sim": sim}


def sentence(line: str) -> tuple[str, dict[str, str]]:
    """Read a sentence as Wireshark does, and check that it has nothing else."""
    kind, _, rest = line.partition(" ")
    parts = re.findall(r"\{([a-zA-Z_-]*?)=(.*?)\}(?=\{|$|\s)", rest)
    assert "".join(f"{{{name}={value}}}" for name, value in parts) == rest
    assert len(dict(parts)) == len(parts)
    return kind, dict(parts)


def asked(*words: str) -> list[tuple[str, dict[str, str]]]:
    done = run_here("extcap", *words)
    assert (done.code, done.err) == (0, "")
    return [sentence(line) for line in done.lines]


def click_option(source: CaptureSource, option: DialogOption) -> click.Option:
    name = option.option or option.call
    (found,) = [each for each in COMMANDS[source.command].params if name in each.opts]
    assert isinstance(found, click.Option)
    return found


def test_it_lists_both_interfaces() -> None:
    (kind, version), *interfaces = asked("--extcap-interfaces", "--extcap-version=4.0")
    assert (kind, version["display"]) == ("extcap", "b-CAP")
    assert interfaces == [
        ("interface", {"value": "bcapscope-proxy", "display": "b-CAP proxy"}),
        ("interface", {"value": "bcapscope-sim", "display": "b-CAP simulator"}),
    ]


@pytest.mark.parametrize("name", SOURCES)
def test_packets_begin_with_the_ip_header(name: str) -> None:
    ((kind, link_type),) = asked("--extcap-dlts", "--extcap-interface", name)
    assert (kind, link_type["number"]) == ("dlt", "101")


@pytest.mark.parametrize("name", SOURCES)
def test_every_option_of_a_dialog_is_complete(name: str) -> None:
    sentences = asked("--extcap-config", "--extcap-interface", name)
    inputs = [parts for kind, parts in sentences if kind == "arg"]
    assert [parts["number"] for parts in inputs] == [str(number) for number in range(len(inputs))]
    assert len({parts["call"] for parts in inputs}) == len(inputs) > 5
    assert all(parts["display"] and parts["tooltip"] for parts in inputs)
    for parts in inputs:
        values = [each for kind, each in sentences if kind == "value" and each["arg"] == parts["number"]]
        assert bool(values) is (parts["type"] == "selector")
        assert [each["value"] for each in values if each["default"] == "true"] == (
            [parts["default"]] if values else []
        )


@pytest.mark.parametrize("source", SOURCES.values(), ids=list(SOURCES))
def test_the_options_are_those_of_the_command(source: CaptureSource) -> None:
    for option in source.options:
        of_command = click_option(source, option)
        assert of_command.is_flag is (option.type is DialogType.SWITCH)
        assert of_command.multiple or option.each_value is None
        if isinstance(of_command.type, click.Choice):
            assert set(of_command.type.choices) == set(option.choices) - {"unset"}
        if option.default not in ("", "unset", "false") and of_command.default is not None:
            assert option.default == str(of_command.default) or of_command.multiple


@pytest.mark.parametrize("source", SOURCES.values(), ids=list(SOURCES))
def test_by_default_only_this_computer_can_connect(source: CaptureSource) -> None:
    words = source.command_words(["--to", "192.168.0.1:5007"] if source.command == "proxy" else [])
    assert words[words.index("--listen") + 1].startswith("127.0.0.1")


def test_the_scenarios_have_their_titles() -> None:
    titles = {name: read_scenario(text).title for name, text in bundled_scenarios().items()}
    assert bundled_titles() == titles
    (option,) = [each for each in SOURCES["bcapscope-sim"].options if each.call == "--scenario"]
    assert set(option.choices) == {"unset", *titles}


def test_no_text_breaks_a_sentence() -> None:
    hostile = DialogOption("--a", "a}{b=c", "line\nbreak", choices={"x": "{y}"})
    lines = list(option_sentences(CaptureSource("a", "a", "sim", (hostile,))))
    assert [sentence(line)[1]["display"] for line in lines] == ["a)(b=c", "(y)"]


def test_values_become_words_of_the_command() -> None:
    faults = ' loss=5%; drop if command == "a;b" ;'
    given = ["--to", "10.0.0.1:5007", "--fault", faults, "--allow", "10.0.0.2, 10.1.0.0/16", "--read-only"]
    words = SOURCES["bcapscope-proxy"].command_words([*given, "--seed="])
    assert words == [
        *("proxy", "--to", "10.0.0.1:5007", "--listen", "127.0.0.1:5007", "--transport", "both"),
        *("--allow", "10.0.0.2", "--allow", "10.1.0.0/16"),
        *("--fault", "loss=5%", "--fault", 'drop if command == "a;b"', "--read-only"),
    ]
    simulator = SOURCES["bcapscope-sim"].command_words(["--profile", "unset", "--port=0"])
    assert simulator == ["sim", "--listen", "127.0.0.1", "--port", "0"]


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("drop if command == 'a;b'; loss=5%", ["drop if command == 'a;b'", "loss=5%"]),
        (r'drop if command == "a\";b"; loss=5%', [r'drop if command == "a\";b"', "loss=5%"]),
        ("drop if command == 'a\"'; loss=5%", ["drop if command == 'a\"'", "loss=5%"]),
        ('drop if command == "a; loss=5%', ['drop if command == "a', "loss=5%"]),
    ],
)
def test_semicolons_in_quotation_marks_belong_to_the_fault(text: str, faults: list[str]) -> None:
    words = SOURCES["bcapscope-proxy"].command_words(["--to", "10.0.0.1:5007", "--fault", text])
    assert [value for name, value in pairwise(words) if name == "--fault"] == faults


@pytest.mark.parametrize(
    ("name", "given", "reason"),
    [
        ("bcapscope-proxy", [], "Controller (--to) is missing"),
        ("bcapscope-proxy", ["--to", " "], "Controller (--to) is missing"),
        ("bcapscope-proxy", ["--to"], "--to needs a value"),
        ("bcapscope-proxy", ["--port", "1"], "bcapscope-proxy has no option --port"),
        (
            "bcapscope-sim",
            ["--scenario=burst", "--scenario-file=a.yaml"],
            "--scenario and --scenario-file ex",
        ),
    ],
)
def test_wrong_options_are_named(name: str, given: list[str], reason: str) -> None:
    with pytest.raises(CaptureOptionError, match=re.escape(reason)):
        SOURCES[name].command_words(given)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--extcap-config"], 'there is no capture interface ""'),
        (["--capture", "--extcap-interface", "eth0", "--fifo", "a"], 'there is no capture interface "eth0"'),
        (["--capture", "--extcap-interface", "bcapscope-sim"], "--fifo needs a value"),
    ],
)
def test_a_wrong_question_is_an_error(words: list[str], reason: str) -> None:
    done = run_here("extcap", *words)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(reason)


def test_wireshark_learns_that_there_are_no_capture_filters() -> None:
    done = run_here("extcap", "--extcap-interface", "bcapscope-sim", "--extcap-capture-filter", "udp")
    assert (done.code, done.err) == (0, "")
    assert "no capture filter" in done.out


def test_the_help_of_the_program_does_not_list_it() -> None:
    assert "extcap" not in run_here("--help").out
    assert run_here("extcap", "--help").code == 0
