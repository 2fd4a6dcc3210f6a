"""The guard: requests that it does not let through, and those that nobody holds up."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from bcapscope.protocol.commands import commands
from bcapscope.protocol.frame import Frame
from bcapscope.protocol.functions import FUNCTIONS, function_name
from bcapscope.protocol.guard import always_passes, passes_read_only
from bcapscope.traffic.filter_tokens import nearest
from bcapscope.traffic.question import COMMAND_FUNCTIONS, Question, question_of

_FUNCTIONS = {function.name.casefold(): function.id for function in FUNCTIONS.values()}
_COMMANDS = {
    command.name.casefold(): command.name
    for function_id in sorted(COMMAND_FUNCTIONS)
    for command in commands(function_id)
}


class Target(NamedTuple):
    """A function, a command, or a command of one function.

    Attributes:
        function_id: None for any function.
        command: in lower case; None for any.
    """

    function_id: int | None
    command: str | None

    def means(self, question: Question) -> bool:
        """Tell whether a request is meant."""
        if self.function_id is not None and self.function_id != question.function_id:
            return False
        return self.command is None or (question.command or "").casefold() == self.command


def read_target(text: str) -> Target:
    """Read ``Robot_Move``, ``slvMove``, or ``Robot_Execute:AnyName`` for a command that is not known.

    Raises:
        ValueError: there is no such function or command.
    """
    name, colon, command = text.partition(":")
    function_id = _FUNCTIONS.get(name.casefold())
    if colon:
        if function_id not in COMMAND_FUNCTIONS:
            takers = ", ".join(FUNCTIONS[each].name for each in sorted(COMMAND_FUNCTIONS))
            raise ValueError(f"{name!r} takes no commands; these do: {takers}")
        return Target(function_id, command.casefold())
    if function_id is not None:
        return Target(function_id, None)
    if name.casefold() in _COMMANDS:
        return Target(None, name.casefold())
    hint = nearest(name, [*(function.name for function in FUNCTIONS.values()), *_COMMANDS.values()])
    raise ValueError(
        f"there is no function or command {name!r}{hint}; a command that is not in the catalogue is written "
        f"with its function, Robot_Execute:{name}"
    )


class Guard:
    """Refuses requests. Whatever stops the robot or lets go of something passes in any case."""

    def __init__(
        self, read_only: bool = False, block: Iterable[Target] = (), allow: Iterable[Target] = ()
    ) -> None:
        """Set it up.

        Args:
            read_only: refuse what moves the robot or changes its state, and what is not known.
            block: refuse these.
            allow: let these through though `read_only` would not; `block` comes first.
        """
        self.read_only = read_only
        self._block = tuple(block)
        self._allow = tuple(allow)

    def refuses(self, request: Frame) -> str:
        """Tell why a request is refused; "" if it is not.

        A damaged frame is refused by a guard that lets only reading pass: nobody knows what the controller
        makes of it.
        """
        values = [argument.variant for argument in request.arguments]
        if always_passes(request.code, values):
            return ""
        question = question_of(request)
        if any(target.means(question) for target in self._block):
            return f"{_name(question)} is blocked"
        if not self.read_only:
            return ""
        if request.problems:
            return f"read-only: a damaged {_name(question)}"
        if any(target.means(question) for target in self._allow) or passes_read_only(request.code, values):
            return ""
        return f"read-only: {_name(question)}"


def _name(question: Question) -> str:
    name = function_name(question.function_id)
    return name if question.command is None else f"{name} {question.command[:60]!r}"
