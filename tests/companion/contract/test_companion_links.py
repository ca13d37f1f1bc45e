"""Addresses and sockets of a formation."""

import time

import pytest
from link_loop import free_port

from testbed.companion.formation_link import FormationLink, parse_formation
from testbed.core.errors import InputError

NAMES = ("leader", "uav1", "uav2")


@pytest.mark.parametrize(
    ("text", "loopback"),
    [
        ("multicast:239.255.41.1:14600", True),
        ("multicast:239.255.41.1:14600@192.168.4.2", False),
        ("peers:127.0.0.1:1,127.0.0.1:2,localhost:3", True),
        ("peers:127.0.0.1:1,127.0.0.1:2,10.0.0.3:3", False),
        ("hub:127.0.0.1:14600", True),
    ],
)
def test_address_is_read_and_written(text, loopback):
    address = parse_formation(text, NAMES)
    assert address.loopback is loopback
    assert parse_formation(str(address), NAMES) == address


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("239.255.41.1:14600", "is no address of a formation.*write multicast:"),
        ("multicast:127.0.0.1:14600", "no multicast group"),
        ("multicast:239.255.41.1:14600@wlan0", "wlan0 is no IPv4 address"),
        ("multicast:239.255.41.1:0", "no HOST:PORT"),
        ("hub:127.0.0.1:70000", "no HOST:PORT"),
        ("hub:127.0.0.1:1,127.0.0.1:2", "has 2 addresses; write one"),
        ("peers:127.0.0.1:1,127.0.0.1:2", "has 2 addresses; write 3, of leader, uav1, uav2"),
        ("peers:127.0.0.1:1,127.0.0.1:2,127.0.0.1:1", "127.0.0.1:1 stands twice"),
    ],
)
def test_wrong_address_is_refused(text, reason):
    with pytest.raises(InputError, match=reason):
        parse_formation(text, NAMES)


def received(link):
    end_s = time.monotonic() + 0.3
    found = []
    while time.monotonic() < end_s:
        found += [data for data, _ in link.receive()]
        time.sleep(0.01)
    return found


@pytest.mark.parametrize("kind", ["multicast", "peers"])
def test_each_hears_the_others(kind):
    ports = [free_port() for _ in NAMES]
    peers = "peers:" + ",".join(f"127.0.0.1:{port}" for port in ports)
    text = f"multicast:239.255.41.1:{ports[0]}" if kind == "multicast" else peers
    links = [FormationLink(parse_formation(text, NAMES), row) for row in range(3)]
    try:
        links[1].send(b"of uav1")
        found = [received(link) for link in links]
    finally:
        for link in links:
            link.close()
    assert found[0] == found[2] == [b"of uav1"]
    # its own message comes back in a group, and is known by its system id
    assert found[1] == ([b"of uav1"] if kind == "multicast" else [])


def test_multicast_does_not_pass_a_router():
    link = FormationLink(parse_formation(f"multicast:239.255.41.1:{free_port()}", NAMES), 0)
    try:
        import socket

        with socket.socket(fileno=socket.dup(link.fileno())) as same:
            assert same.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 1
    finally:
        link.close()


def test_port_of_another_program_is_refused():
    port = free_port()
    address = parse_formation(f"peers:127.0.0.1:{port},127.0.0.1:1,127.0.0.1:2", NAMES)
    link = FormationLink(address, 0)
    try:
        with pytest.raises(InputError, match="another program has this port"):
            FormationLink(address, 0)
    finally:
        link.close()
