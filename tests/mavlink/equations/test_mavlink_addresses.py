"""Addresses of MAVLink links."""

import pytest

from testbed.core.errors import InputError
from testbed.mavlink.udp_endpoint import Address, link_addresses, parse_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("udpout:127.0.0.1:14550", Address("udpout", "127.0.0.1", 14550)),
        ("udpin:0.0.0.0:14551", Address("udpin", "0.0.0.0", 14551)),
        ("udp:localhost:14551", Address("udpin", "localhost", 14551)),
        ("14550", Address("udpout", "127.0.0.1", 14550)),
        ("14550+10", Address("udpout", "127.0.0.1", 14550, 10)),
        ("udpin::14550", Address("udpin", "127.0.0.1", 14550)),
        ("udpin:127.0.0.1:14550+1", Address("udpin", "127.0.0.1", 14550, 1)),
    ],
)
def test_address_parses_and_formats(text, address):
    assert parse_address(text) == address
    assert parse_address(str(address)) == address


@pytest.mark.parametrize(
    "text",
    ["", "udpout", "127.0.0.1:14550", "tcp:127.0.0.1:5760", "udpin:::1:14550", "udpout:h:x", "1 2"],
)
def test_invalid_address_is_an_error_with_example(text):
    with pytest.raises(InputError, match="is not a MAVLink address; write udpout:HOST:PORT"):
        parse_address(text)


@pytest.mark.parametrize("text", ["0", "65536", "udpin:h:14550+0", "14550+70000"])
def test_port_or_step_out_of_range_is_an_error(text):
    with pytest.raises(InputError, match="give"):
        parse_address(text)


def test_port_of_each_aircraft_is_limited():
    address = parse_address("udpin::65500+20")
    assert [address.for_aircraft(row).port for row in range(2)] == [65500, 65520]
    assert address.for_aircraft(1).step == 0
    with pytest.raises(InputError, match="65540 of aircraft 3; give"):
        address.for_aircraft(2)
    with pytest.raises(InputError, match="65540 of uav2; give"):
        list(link_addresses([address], ["leader", "uav1", "uav2"]))


def test_port_serves_all_aircraft_or_one():
    found = link_addresses([parse_address("14550"), parse_address("14560+10")], ["leader", "uav1"])
    assert [(link.port, list(rows)) for link, rows in found] == [
        (14550, [0, 1]),
        (14560, [0]),
        (14570, [1]),
    ]


@pytest.mark.parametrize("again", ["14550", "udpout::14550", "14540+10"])
def test_repeated_address_is_an_error(again):
    both = [parse_address("udpout:127.0.0.1:14550"), parse_address(again)]
    with pytest.raises(InputError, match="14550: given twice; give each address once"):
        list(link_addresses(both, ["leader", "uav1"]))


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("127.3.2.1", True), ("localhost", True)]
    + [("0.0.0.0", False), ("192.168.1.7", False), ("example.org", False)],
)
def test_loopback_hosts_are_recognised(host, loopback):
    assert Address("udpout", host, 14550).loopback is loopback
