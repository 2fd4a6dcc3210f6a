"""What is said of listeners, and what is wrong with it."""

from __future__ import annotations

import pytest

from bcapscope.proxy.listener_spec import BOTH, ListenerSpec, ListenerSpecError, parse_listener_specs
from bcapscope.traffic.observation import Endpoint, Transport


def test_pairs_in_their_order() -> None:
    listeners = parse_listener_specs(
        ["127.0.0.1:5008", "tcp:[::1]:5009", "udp:localhost:0"],
        ["192.168.0.1:5007", "[fe80::1]:5007", "rc8:5007"],
    )
    assert listeners == (
        ListenerSpec(Endpoint("127.0.0.1", 5008), Endpoint("192.168.0.1", 5007), BOTH),
        ListenerSpec(Endpoint("::1", 5009), Endpoint("fe80::1", 5007), (Transport.TCP,)),
        ListenerSpec(Endpoint("127.0.0.1", 0), Endpoint("rc8", 5007), (Transport.UDP,)),
    )


@pytest.mark.parametrize(
    ("listen", "to", "wrong"),
    [
        ([], [], "no address to listen on"),
        (["127.0.0.1:1"], [], "1 --listen and 0 --to"),
        (["127.0.0.1"], ["a:1"], "--listen 127.0.0.1: the port is missing"),
        (["127.0.0.1:x"], ["a:1"], "'x' is not a port"),
        (["127.0.0.1:65536"], ["a:1"], "'65536' is not a port"),
        (["127.0.0.1:²"], ["a:1"], "'²' is not a port"),
        (["robot:1"], ["a:1"], "'robot' is not an IP address"),
        (["::1:5008"], ["a:1"], "brackets"),
        (["[::1:5008"], ["a:1"], "'[::1' is not a host name or address"),
        (["::1]:5008"], ["a:1"], "'::1]' is not a host name or address"),
        (["upd:127.0.0.1:1"], ["a:1"], "'upd:127.0.0.1' is not a host name or address"),
        (["127.0.0.1:1"], ["tcp:a:1"], "'tcp:a' is not a host name or address"),
        (["5008"], ["a:1"], "the port is missing, as in 127.0.0.1:5008"),
        (["127.0.0.1:1"], [":5007"], "--to :5007: '' is not a host name or address"),
        (["127.0.0.1:1"], ["a b:5007"], "'a b' is not a host name or address"),
        (["127.0.0.1:1"], ["a:0"], "port 0"),
        (["127.0.0.1:1", "udp:127.0.0.1:1"], ["a:1", "b:1"], "given twice for UDP"),
        (["127.0.0.1:1"], ["127.0.0.1:1"], "to itself"),
    ],
)
def test_errors_name_the_part(listen: list[str], to: list[str], wrong: str) -> None:
    with pytest.raises(ListenerSpecError) as error:
        parse_listener_specs(listen, to)
    assert wrong in str(error.value)


def test_one_port_may_carry_udp_here_and_tcp_there() -> None:
    assert len(parse_listener_specs(["udp:127.0.0.1:1", "tcp:127.0.0.1:1"], ["a:1", "b:1"])) == 2


def test_who_is_allowed() -> None:
    (listener,) = parse_listener_specs(
        ["[::1]:1"], ["a:1"], "udp", ["10.0.0.0/8", "192.168.0.7", "fe80::/10"]
    )
    hosts = ("10.1.2.3", "192.168.0.7", "192.168.0.8", "fe80::1%eth0", "::1")
    allowed = [host for host in hosts if listener.allows(host)]
    assert allowed == ["10.1.2.3", "192.168.0.7", "fe80::1%eth0"]
    with pytest.raises(ListenerSpecError, match=r"--allow 10\.0\.0\.1/8: neither an address nor a network"):
        parse_listener_specs(["[::1]:1"], ["a:1"], "udp", ["10.0.0.1/8"])
