"""The gate of the served screen: which requests pass."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bcapscope.traffic.observation import Endpoint
from bcapscope.tui.web.web_gate import WebGate, WebRequest

GATE = WebGate(Endpoint("127.0.0.1", 8000))
HOSTS = ("127.0.0.1:8000",)
ENTRANCE = WebRequest("/", HOSTS, token=GATE.entry_url.rpartition("=")[2])
PAGE = WebRequest(f"{GATE.base_path}/", HOSTS, cookie=GATE.cookie)
STATIC = replace(PAGE, path=f"{GATE.base_path}/static/js/textual.js", fetch_site="same-origin")
WEBSOCKET = replace(PAGE, path=f"{GATE.base_path}/ws", origins=(GATE.origin,), is_websocket=True)
ALL = [ENTRANCE, PAGE, STATIC, WEBSOCKET]


@pytest.mark.parametrize("request_", ALL)
def test_requests_of_its_own_page_pass(request_: WebRequest) -> None:
    assert GATE.refusal_reason(request_) == ""


@pytest.mark.parametrize("request_", ALL)
@pytest.mark.parametrize(
    "hosts",
    [
        (),
        ("",),
        ("evil.example:8000",),
        ("localhost:8000",),
        ("127.0.0.1",),
        ("127.0.0.1:8001",),
        (*HOSTS, *HOSTS),
        ("127.0.0.1:8000.evil.example",),
    ],
)
def test_a_foreign_host_is_refused(request_: WebRequest, hosts: tuple[str, ...]) -> None:
    assert "answers only to http://127.0.0.1:8000" in GATE.refusal_reason(replace(request_, hosts=hosts))


@pytest.mark.parametrize("request_", ALL)
@pytest.mark.parametrize(
    "origins",
    [
        ("null",),
        ("",),
        ("https://evil.example",),
        ("http://127.0.0.1:8001",),
        ("https://127.0.0.1:8000",),
        ("http://localhost:8000",),
        (GATE.origin, GATE.origin),
        (GATE.origin, "https://evil.example"),
    ],
)
def test_a_foreign_origin_is_refused(request_: WebRequest, origins: tuple[str, ...]) -> None:
    assert "other pages" in GATE.refusal_reason(replace(request_, origins=origins))


def test_a_websocket_without_an_origin_is_refused() -> None:
    assert "other pages" in GATE.refusal_reason(replace(WEBSOCKET, origins=()))


@pytest.mark.parametrize("request_", [PAGE, STATIC, WEBSOCKET])
@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_what_another_page_requests_is_refused(request_: WebRequest, site: str) -> None:
    assert "other pages" in GATE.refusal_reason(replace(request_, fetch_site=site))


def test_a_link_on_another_page_may_lead_to_the_entrance() -> None:
    assert GATE.refusal_reason(replace(ENTRANCE, fetch_site="cross-site")) == ""


@pytest.mark.parametrize(
    "token",
    ["", "x", ENTRANCE.token[:-1], ENTRANCE.token + "x", GATE.cookie, "\udcff"],
    ids=["missing", "short", "cut", "longer", "the cookie", "no text"],
)
def test_a_wrong_token_is_refused(token: str) -> None:
    assert "token" in GATE.refusal_reason(replace(ENTRANCE, token=token))


@pytest.mark.parametrize("request_", [PAGE, STATIC, WEBSOCKET])
@pytest.mark.parametrize(
    "cookie", ["", "x", GATE.cookie[:-1], ENTRANCE.token], ids=["missing", "short", "cut", "the token"]
)
def test_a_wrong_cookie_is_refused(request_: WebRequest, cookie: str) -> None:
    assert "token" in GATE.refusal_reason(replace(request_, cookie=cookie, token=ENTRANCE.token))


@given(st.text(max_size=60))
def test_no_other_path_passes(path: str) -> None:
    assert GATE.refusal_reason(replace(PAGE, path=f"/{path}", token="")) != ""


def test_a_websocket_needs_the_cookie_also_at_the_entrance() -> None:
    assert GATE.refusal_reason(replace(WEBSOCKET, path="/", token=ENTRANCE.token, cookie="")) != ""


@pytest.mark.parametrize(
    ("address", "origin"),
    [
        (Endpoint("::1", 8000), "http://[::1]:8000"),
        (Endpoint("127.0.0.1", 80), "http://127.0.0.1"),
        (Endpoint("::1", 80), "http://[::1]"),
    ],
)
def test_the_origin_is_written_as_browsers_write_it(address: Endpoint, origin: str) -> None:
    gate = WebGate(address)
    assert gate.origin == origin
    assert gate.entry_url.startswith(f"{origin}/?token=")
    assert (
        gate.refusal_reason(
            replace(PAGE, path=f"{gate.base_path}/", cookie=gate.cookie, hosts=(gate.authority,))
        )
        == ""
    )


def test_each_gate_has_secrets_of_its_own() -> None:
    gates = [WebGate(Endpoint("127.0.0.1", 8000)) for _ in range(20)]
    secrets = {each for gate in gates for each in (gate.entry_url, gate.base_path, gate.cookie)}
    assert len(secrets) == 60
    assert all(len(each) > 40 for each in secrets)
