"""Philox4x32-10 against its published answers, its definition, and chance."""

import hashlib

import numpy as np
import pytest
from network_samples import PACKETS, assert_counts, assert_normal, assert_share

from testbed.core.compile import entry
from testbed.network.channel import make_channel
from testbed.network.links import resolve_links
from testbed.network.philox import LOW, key_of, philox, unit
from testbed.scenario.network import Network

ONES = 0xFFFFFFFF
# Random123, tests/kat_vectors: philox4x32 with 10 rounds; counter, key, answer
KNOWN = [
    (
        (0, 0, 0, 0),
        (0, 0),
        (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8),
    ),
    (
        (ONES, ONES, ONES, ONES),
        (ONES, ONES),
        (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD),
    ),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


def number_of(counter):
    return counter[0] + (counter[1] << 32)


def by_definition(key, counter):
    """The paper's rounds in integers of any length."""
    x, k = list(counter), list(key)
    for _ in range(10):
        high0, low0 = divmod(0xD2511F53 * x[0], 2**32)
        high1, low1 = divmod(0xCD9E8D57 * x[2], 2**32)
        x = [high1 ^ x[1] ^ k[0], low1, high0 ^ x[3] ^ k[1], low0]
        k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
    return tuple(x)


@entry
def compiled(key0, key1, counter, copy, block):
    return philox(key0, key1, counter, copy, block)


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
def test_philox_gives_published_answers(counter, key, answer):
    args = *map(np.uint64, key), np.uint64(number_of(counter)), *counter[2:]
    assert tuple(map(int, philox(*args))) == answer
    assert tuple(map(int, compiled(*args))) == answer
    assert by_definition(key, counter) == answer


def test_philox_matches_its_definition():
    """An array of them at once, one by one by the definition, and compiled."""
    drawn = np.random.default_rng(3).integers(0, 2**32, (200, 6), dtype=np.uint64)
    key0, key1, low, high, copy, block = drawn.T
    counters = low + (high << np.uint64(32))
    words = np.transpose(philox(key0, key1, counters, copy, block))
    for k, (*key, first, second, third, fourth) in enumerate(drawn.tolist()):
        expected = by_definition(key, (first, second, third, fourth))
        assert tuple(words[k].tolist()) == expected
        one = compiled(key0[k], key1[k], counters[k], copy[k], block[k])
        assert tuple(map(int, one)) == expected


def test_key_is_that_of_the_digest():
    digest = hashlib.sha256(b"7/network/leader>uav1").digest()
    assert key_of(7, "network/leader>uav1") == tuple(
        sum(digest[4 * word + k] << (8 * k) for k in range(4)) for word in range(2)
    )


def test_keys_of_links_and_seeds_differ():
    names = ["leader", *(f"uav{i}" for i in range(1, 12))]
    keys = {
        tuple(key)
        for seed in range(20)
        for key in make_channel(resolve_links(names, Network()), seed)
        .links["key"]
        .reshape(-1, 2)
        .tolist()
    }
    assert len(keys) == 20 * 11 * 12


def test_unit_is_never_0_or_1():
    ends = unit(np.array([0, LOW], dtype=np.uint64))
    assert ends == pytest.approx([2.0**-33, 1.0 - 2.0**-33], abs=0)


@pytest.fixture(scope="module")
def words():
    """Words (4, copies and blocks, packets) as a link asks for them."""
    key = key_of(1, "network/leader>uav1")
    numbers, copies = np.arange(PACKETS, dtype=np.uint64), np.array([[0], [1], [0], [1]])
    return np.array(philox(*key, numbers, copies, np.array([[0], [0], [1], [1]])))


def test_words_are_uniform(words):
    for each in words.reshape(-1, PACKETS):
        cells = 1024
        assert_counts(np.bincount(each >> np.uint64(22), minlength=cells), np.ones(cells))


def test_every_bit_is_fair(words):
    for bit in range(32):
        assert_share((words >> np.uint64(bit)) & np.uint64(1), 0.5)


def test_words_of_near_packets_are_independent(words):
    """Pairs fall evenly into the squares of a board: of words, and of packets next to another."""
    flat = words.reshape(-1, PACKETS) >> np.uint64(27)
    for first in range(len(flat)):
        second = (first + 1) % len(flat)
        for lag in (0, 1):
            pair = flat[first][: PACKETS - lag] * np.uint64(32) + flat[second][lag:]
            assert_counts(np.bincount(pair.astype(np.int64), minlength=1024), np.ones(1024))


def test_words_of_links_are_independent():
    """Words of the same packet on two links, and with two seeds, are uncorrelated."""
    numbers = np.arange(PACKETS)
    first = unit(philox(*key_of(1, "network/leader>uav1"), numbers, 0, 0)[0]) - 0.5
    for seed, name in ((1, "network/leader>uav2"), (1, "network/uav1>leader"), (2, "network/x")):
        second = unit(philox(*key_of(seed, name), numbers, 0, 0)[0]) - 0.5
        assert_normal(12.0 * (first * second).sum() / np.sqrt(PACKETS))


def test_one_counter_bit_changes_half_of_all_bits():
    key = key_of(1, "network/leader>uav1")
    rng = np.random.default_rng(5)
    for bit in (0, 1, 7, 31, 32, 63):
        number = rng.integers(0, 2**63, 2000, dtype=np.uint64)
        other = number ^ np.uint64(1 << bit)
        changed = np.array(philox(*key, number, 0, 0)) ^ np.array(philox(*key, other, 0, 0))
        assert_share((changed[..., None] >> np.arange(32, dtype=np.uint64)) & np.uint64(1), 0.5)
