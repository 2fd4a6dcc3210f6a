"""``bcapscope extcap``: the command that Wireshark starts to list capture interfaces and to capture."""

from __future__ import annotations

import os
from collections.abc import Iterable

import click

from bcapscope.cli.common.data_output import echo
from bcapscope.cli.common.exit_codes import ExitCode, exit_with
from bcapscope.messages import MessageFormatter, language_of
from bcapscope.wireshark.capture_sources import (
    CaptureOptionError,
    CaptureSource,
    capture_sources,
    interface_sentences,
    link_type_sentences,
    option_sentences,
)


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--extcap-interfaces", is_flag=True, help="List the capture interfaces.")
@click.option("--extcap-interface", "name", metavar="NAME", help="Use this capture interface.")
@click.option("--extcap-dlts", is_flag=True, help="List the link types of the interface.")
@click.option("--extcap-config", is_flag=True, help="List the options of the interface.")
@click.option("--capture", is_flag=True, help="Capture until Wireshark ends the capture.")
@click.option("--fifo", metavar="PIPE", help="Write the packets to this named pipe.")
@click.option(
    "--extcap-capture-filter",
    "capture_filter",
    metavar="FILTER",
    help="Wireshark checks a capture filter with this option. Without --capture, print that capture filters "
    "are not supported. With --capture, this option has no effect.",
)
@click.option("--extcap-version", metavar="VERSION", expose_value=False, help="Has no effect.")
@click.argument("given", nargs=-1, type=click.UNPROCESSED, metavar="[OPTION]...")
def command(
    *,
    extcap_interfaces: bool,
    name: str | None,
    extcap_dlts: bool,
    extcap_config: bool,
    capture: bool,
    fifo: str | None,
    capture_filter: str | None,
    given: tuple[str, ...],
) -> None:
    """Speak Wireshark's extcap protocol. `bcapscope wireshark --install` lets Wireshark start this command.

    --extcap-config lists the options of an interface. docs/wireshark.md shows how to capture from Wireshark.

    Exit codes: 0: done, or Wireshark ended the capture; 1: the proxy or simulator ended unexpectedly;
    2: invalid options; others: those of `proxy` and `sim`.
    """
    words = MessageFormatter(language_of(os.environ))
    sources = capture_sources()
    if extcap_interfaces:
        _print_sentences(interface_sentences(sources))
        return
    if name not in sources:
        names = ", ".join(sources)
        exit_with(words("extcap.unknown-interface", interface=name or "", names=names), ExitCode.USAGE)
    if extcap_dlts:
        _print_sentences(link_type_sentences())
    elif extcap_config:
        _print_sentences(option_sentences(sources[name]))
    elif capture:
        _capture(sources[name], fifo, given, words)
    elif capture_filter:
        echo(words("extcap.no-filter"))


def _print_sentences(sentences: Iterable[str]) -> None:
    for sentence in sentences:
        echo(sentence)


def _capture(
    source: CaptureSource, pipe: str | None, given: tuple[str, ...], words: MessageFormatter
) -> None:
    """Capture until Wireshark ends the capture. If capturing fails, Wireshark shows the reason."""
    from bcapscope.live.extcap_capture import CaptureFailedError, run_capture, wireshark_connected

    if not pipe:
        exit_with(words("extcap.no-value", option="--fifo"), ExitCode.USAGE)
    with wireshark_connected(pipe) as ends:
        try:
            run_capture(source.command_words(given), pipe, ends)
        except CaptureOptionError as error:
            exit_with(words.text(error.message), ExitCode.USAGE)
        except CaptureFailedError as error:
            exit_with(words.text(error.message), error.code)
