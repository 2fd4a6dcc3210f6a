"""``bcapscope wireshark``: install a b-CAP dissector and capture interfaces for Wireshark."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import click

from bcapscope.cli.common import options
from bcapscope.cli.common.data_output import echo
from bcapscope.messages import MessageFormatter
from bcapscope.render.escape import printable
from bcapscope.wireshark import plugin_folder
from bcapscope.wireshark.dissector import dissector_text


class _Action(StrEnum):
    INSTALL = "install"
    PRINT = "print"
    UNINSTALL = "uninstall"


@click.command()
@options.choice_flag(_Action.INSTALL, "actions", "Install the dissector and the capture interfaces.")
@options.choice_flag(_Action.PRINT, "actions", "Print the dissector.")
@options.choice_flag(_Action.UNINSTALL, "actions", "Remove what --install wrote.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write the dissector to this folder, and the capture interfaces to its subfolder extcap. Default: "
    "your own folders, which Wireshark lists under About > Folders.",
)
@options.language
def command(*, actions: tuple[_Action, ...], folder: Path | None, words: MessageFormatter) -> None:
    """Install a dissector, so that Wireshark and tshark decode b-CAP as `decode` does.

    bcapscope generates the dissector from its own tables. Run `--install` again after an update of bcapscope.
    --install also writes coloring rules for the packet list, and prints how to import them. `wireshark` also
    adds two capture interfaces: a proxy and a simulated controller.

    docs/wireshark.md describes fields, links, display filters and capture interfaces.

    Exit codes: 0: done; 2: invalid command line; 6: a file could not be written or removed.
    """
    if len(set(actions)) != 1:
        raise click.UsageError("choose one of --install, --print and --uninstall")
    action = actions[0]
    if action is _Action.PRINT:
        if folder is not None:
            raise click.UsageError("--folder has no effect with --print: leave it out")
        echo(dissector_text(), end=False)
        return
    target = plugin_folder.default_plugin_folder() if folder is None else folder
    launcher_folders = plugin_folder.extcap_folders(folder)
    if action is _Action.INSTALL:
        dissector, coloring_rules, launchers = plugin_folder.install(target, launcher_folders)
        echo(printable(words("wireshark.installed", path=str(dissector))))
        for path in launchers:
            echo(printable(words("wireshark.launcher", path=str(path))))
        echo(printable(words("wireshark.coloring", path=str(coloring_rules))))
        return
    removed = plugin_folder.uninstall(target, launcher_folders)
    for path in removed:
        echo(printable(words("wireshark.removed", path=str(path))))
    if not removed:
        echo(printable(words("wireshark.nothing", folder=str(target))))
