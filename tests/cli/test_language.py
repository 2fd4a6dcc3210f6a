"""``--lang``: the text of a command follows it, JSON and CSV do not."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.cli.run import CAPTURES, run_here

JAPANESE = re.compile("[\u3041-\u9fff]")
LOST, SESSION = CAPTURES / "slave-mode-lost.pcapng", CAPTURES / "slave-session.pcapng"
RETRIES, MALFORMED = CAPTURES / "retry-story.pcapng", CAPTURES / "malformed.pcapng"


@pytest.mark.parametrize(
    "arguments",
    [
        ("decode", MALFORMED),
        ("decode", MALFORMED, "--tree"),
        ("calls", RETRIES),
        ("calls", RETRIES, "--tree"),
        ("stats", LOST),
        ("compare", SESSION, LOST),
        ("diagnose", LOST),
    ],
    ids=lambda arguments: "-".join(map(str, arguments[::2])),
)
def test_text_follows_the_language(arguments: tuple[str | Path, ...]) -> None:
    english, japanese = (run_here(*arguments, "--lang", language) for language in ("en", "ja"))
    assert english.code == japanese.code
    assert not JAPANESE.search(english.out + english.err)
    assert JAPANESE.search(japanese.out)
    assert JAPANESE.search(japanese.err)
    assert len(japanese.lines) == len(english.lines) or arguments[0] in ("compare", "diagnose")


@pytest.mark.parametrize(
    "arguments",
    [
        ("decode", MALFORMED, "--json"),
        ("decode", MALFORMED, "--csv"),
        ("calls", RETRIES, "--json"),
        ("stats", LOST, "--json"),
        ("slave", LOST, "--json"),
        ("compare", SESSION, LOST, "--json"),
        ("diagnose", LOST, "--json"),
    ],
    ids=lambda arguments: f"{arguments[0]}{arguments[-1]}",
)
def test_json_and_csv_stay_english(arguments: tuple[str | Path, ...]) -> None:
    english, japanese = (run_here(*arguments, "--lang", language) for language in ("en", "ja"))
    assert japanese.out == english.out
    assert japanese.err != english.err


def test_the_messages_of_extract_follow_the_language(tmp_path: Path) -> None:
    done = run_here("extract", LOST, "-o", tmp_path / "made.csv", "--lang", "ja")
    assert JAPANESE.search(done.err.splitlines()[-1])
    english = run_here("extract", LOST, "-o", tmp_path / "made.csv", "--force", "--lang", "en")
    assert english.code == done.code
    assert not JAPANESE.search(english.err)


def test_the_environment_chooses_the_language(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LC_ALL", "ja_JP.UTF-8")
    assert run_here("calls", RETRIES).out == run_here("calls", RETRIES, "--lang", "ja").out


def test_a_report_is_in_the_language_of_its_reader(tmp_path: Path) -> None:
    pages = {}
    for language in ("en", "ja"):
        path = tmp_path / f"{language}.html"
        assert run_here("report", LOST, "-o", path, "--lang", language).code == 0
        pages[language] = path.read_text("utf-8")
    assert '<html lang="en"' in pages["en"]
    assert '<html lang="ja"' in pages["ja"]
    assert "検出事項" in pages["ja"]
    assert "検出事項" not in pages["en"]


def test_ping_and_play_follow_the_language() -> None:
    pinged = run_here("ping", "127.0.0.1", "-p", "1", "-n", "1", "--lang", "ja")
    assert JAPANESE.search(pinged.err)
    path = CAPTURES / "joint-trajectory.yaml"
    played = run_here("play", path, "127.0.0.1", "-p", "1", "--dry-run", "--lang", "ja")
    assert JAPANESE.search(played.out)
    assert pinged.code == 9
