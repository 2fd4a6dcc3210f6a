"""Playbooks: the calls of a client program and the replies that it must get, as data, on each profile.

A playbook is a text file in `playbooks`. One line is one step. A line that begins with spaces continues the
one before, and `#` begins a comment. ``profiles:`` names the profiles that the lines below are for::

    % variables: {I1: 5}                    a line of the scenario: what the controller is like at the start
    profiles: rc8 rc9
    client act: udp own                     a client, its transport and what it puts into reserved
    act: Service_Start "" => none           a call and its reply
    act x20: Robot_Execute $arm "slvMove" r8[]:{0+0.1n},0,90,0,90,0 => r8[8]
    act, reply lost: Robot_Execute $arm "CurJnt" - => r8[8] | rc7 r4[8]
    act sends: Robot_Move $arm i4:1 "J(90,0,90,0,90,0)" ""
    act gets: => 83201404 EMPTY
    act abandons: Robot_Execute $arm "CurJnt" -     sent, but the serial is used again
    wait: 100 ms
    controller: {action: emergency-stop}    an event, as in a scenario

Arguments: ``"text"`` is VT_BSTR, ``-`` is EMPTY, ``$name`` is a value that an earlier reply was stored under,
``( a b )`` is an array of VARIANT. All else is read by
`bcapscope.protocol.codec.variant_notation.parse_variant`. ``{a+bn}`` is a number that grows with each
repetition n = 0, 1, 2, ...

Replies: ``none`` is no argument, ``EMPTY`` is one EMPTY, ``$name`` stores an I4. Eight hexadecimal digits are
a result other than S_OK. ``i4``, ``bstr``, ``r8[8]`` and ``r8[]`` give only the type and the number of
elements; ``i4:5``, ``"text"`` and ``r8[]:1,2`` give the value too. ``in 400 ms`` is how long the call takes.
After ``|`` comes what other profiles answer.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from bcapscope.protocol.codec.variant import EMPTY, Variant
from bcapscope.protocol.codec.variant_notation import parse_variant
from bcapscope.simulator.argument_values import bstr, variant_array
from bcapscope.simulator.profile import PROFILES

FOLDER = Path(__file__).parent / "playbooks"

_PROVIDERS = {"rc9": "CaoProv.DENSO.VRC9"}
_STEP = re.compile(
    r"(?P<client>[a-z]+)(?: x(?P<times>\d+))?(?P<fates>(?:, (?:request|reply) lost)*)(?P<verb> \w+)?"
)
_TOKEN = re.compile(r'"[^"]*"|[()]|[^\s()"]+')
_GROWING = re.compile(r"\{(-?[\d.]+)([+-][\d.]+)n\}")
_RESULT = re.compile(r"[0-9A-F]{8}")


class Reply(NamedTuple):
    """What a call must be answered.

    Attributes:
        result: HRESULT.
        value: tokens of the argument; () for a result alone, whose argument does not matter.
        ms: how long the call takes; None where that does not matter.
    """

    result: int
    value: tuple[str, ...]
    ms: float | None


@dataclass(frozen=True, slots=True)
class Step:
    """One line.

    Attributes:
        place: file and line.
        subject: name of the client, or `wait` or `controller`.
        verb: `calls`, `sends`, `gets` or `abandons` of a client.
        times: so often.
        fates: what becomes of the first attempts: `request lost`, `reply lost`.
        words: the function and its arguments, or what happens.
        reply: the one of the profile; None where none is waited for.
    """

    place: str
    subject: str
    verb: str
    times: int
    fates: tuple[str, ...]
    words: tuple[str, ...]
    reply: Reply | None


class Playbook(NamedTuple):
    """The steps of one profile.

    Attributes:
        scenario: YAML of what the controller is like at the start.
        clients: transport and reserved of each, by name.
        steps: in their order.
    """

    scenario: str
    clients: dict[str, tuple[str, str]]
    steps: tuple[Step, ...]


def playbooks() -> Iterator[tuple[str, str]]:
    """Yield each playbook's name with each profile that it has steps for."""
    for path in sorted(FOLDER.glob("*.play")):
        for profile in sorted(PROFILES):
            if read(path, profile).steps:
                yield path.stem, profile


def read(path: Path, profile: str) -> Playbook:
    """Read the steps of a playbook that are for a profile."""
    scenario, clients, steps = ["title: x", f"profile: {profile}"], {}, []
    concerned = True
    for place, line in _lines(path):
        head, _, rest = line.partition(":")
        if line.startswith("%"):
            scenario.append(line[1:].strip())
        elif head == "profiles":
            concerned = profile in rest.split()
        elif head.startswith("client "):
            transport, reserved = rest.split()
            clients[head.removeprefix("client ")] = (transport, reserved)
        elif concerned:
            steps.append(_step(place, head, rest, profile))
    return Playbook("\n".join(scenario), clients, tuple(steps))


def _lines(path: Path) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for number, raw in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        line = re.sub(r"(^|\s)#.*", "", raw).rstrip()
        if line.startswith(" ") and found:
            found[-1] = (found[-1][0], f"{found[-1][1]} {line.strip()}")
        elif line:
            found.append((f"{path.name}:{number}", line))
    return found


def _step(place: str, head: str, rest: str, profile: str) -> Step:
    if head == "controller":
        return Step(place, head, "", 1, (), (rest.strip(),), None)
    match = _STEP.fullmatch(head)
    assert match, f"{place}: {head!r} is no step"
    asked, arrow, answers = rest.partition("=>")
    reply = _reply(place, answers, profile) if arrow else None
    fates = tuple(fate.strip() for fate in match["fates"].split(",") if fate.strip())
    verb = (match["verb"] or " calls").strip()
    return Step(
        place, match["client"], verb, int(match["times"] or 1), fates, tuple(_TOKEN.findall(asked)), reply
    )


def _reply(place: str, answers: str, profile: str) -> Reply:
    usual, *others = answers.split("|")
    for other in others:
        names, _, answer = other.strip().partition(" ")
        assert set(names.split(",")) <= set(PROFILES), f"{place}: {names!r} is no profile"
        if profile in names.split(","):
            usual = answer
    match = re.fullmatch(r"(.*?)(?: in ([\d.]+) ms)?", usual.strip())
    assert match
    tokens = tuple(_TOKEN.findall(match[1]))
    assert tokens, f"{place}: no reply for {profile}"
    refused = _RESULT.fullmatch(tokens[0])
    result = int(tokens[0], 16) if refused else 0
    return Reply(result, tokens[1:] if refused else tokens, float(match[2]) if match[2] else None)


def arguments(words: Sequence[str], names: dict[str, Variant], repetition: int) -> list[Variant]:
    """Make the arguments of a call."""
    stack: list[list[Variant]] = [[]]
    for word in words:
        if word == "(":
            stack.append([])
        elif word == ")":
            made = variant_array(*stack.pop())
            stack[-1].append(made)
        else:
            stack[-1].append(_argument(word, names, repetition))
    (found,) = stack
    return found


def _argument(word: str, names: dict[str, Variant], repetition: int) -> Variant:
    if word.startswith('"'):
        return bstr(word.strip('"'))
    if word.startswith("$"):
        return names[word]
    if word == "-":
        return EMPTY
    return parse_variant(
        _GROWING.sub(lambda match: repr(float(match[1]) + float(match[2]) * repetition), word)
    )


def first_names(profile: str) -> dict[str, Variant]:
    """Return the values that each playbook may use."""
    return {"$provider": bstr(_PROVIDERS.get(profile, "CaoProv.DENSO.VRC"))}
