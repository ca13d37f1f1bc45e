"""Packets over one link alone: those of a channel, keys and refusals."""

import network_samples as samples
import numpy as np
import pytest

from testbed.core.errors import InputError
from testbed.network.links import PacketOutcome
from testbed.network.single_link import KEYS, send_packets

LINK = {
    "delay_s": 0.1,
    "jitter": {"distribution": "normal", "spread_s": 0.03, "correlation": 0.5},
    "loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.4},
    "duplicate": 0.1,
    "rate": {"bit_per_s": 57600, "queue_packets": 5},
}


@pytest.mark.parametrize("arithmetic", ["exact", "netem"])
def test_packets_are_those_of_a_channel(arithmetic):
    """Sent one by one, and by a compiled loop over all packets of a channel of two aircraft."""
    channel = samples.make(("sender", "receiver"), seed=7, **LINK, arithmetic=arithmetic)
    loop = samples.transmit(channel, packets=500, period_s=0.02)
    alone = send_packets(loop.sent_s[:, 0], seed=7, **LINK, arithmetic=arithmetic)
    np.testing.assert_array_equal(alone.received_s, loop.received_s[:, 0, 0])
    np.testing.assert_array_equal(alone.second_s, loop.second_s[:, 0, 0])
    np.testing.assert_array_equal(alone.outcome, loop.outcome[:, 0, 0])
    assert 0 < np.isnan(alone.received_s).sum() < 500 > np.isnan(alone.second_s).sum()


def test_a_link_without_keys_delivers_at_once():
    packets = send_packets([0.0, 0.5, 0.5])
    np.testing.assert_array_equal(packets.received_s, packets.sent_s)
    assert not packets.outcome.any()


def test_scripted_losses_and_a_trace_act(tmp_path):
    packets = send_packets([0.0, 0.1, 0.2], delay_s=0.1, drop=[1], blackout_s=[[0.15, 0.3]])
    expected = [PacketOutcome.DELIVERED, PacketOutcome.LISTED, PacketOutcome.BLACKOUT]
    assert packets.outcome.tolist() == expected
    (tmp_path / "trace.csv").write_text("sent_s,received_s\n0,0.25\n1,\n2,2.5\n")
    traced = send_packets([0.0, 1.0, 2.0], trace={"file": str(tmp_path / "trace.csv")})
    np.testing.assert_allclose(traced.received_s, [0.25, np.nan, 2.5])


@pytest.mark.parametrize(
    ("sent_s", "keys", "said"),
    [
        ([0.0], {"los": 0.1}, "a link alone has no los"),
        ([0.0], {"range_loss": [[100, 0.5]]}, "has no range_loss"),
        ([1.0, 0.0], {}, "that do not decrease"),
        ([np.nan], {}, "finite times"),
        ([], {}, "one or more"),
        ([0.0], {"loss": 2.0}, "less than or equal to 1"),
    ],
)
def test_a_wrong_link_is_refused(sent_s, keys, said):
    with pytest.raises(ValueError, match=said) as caught:
        send_packets(sent_s, **keys)
    assert isinstance(caught.value, InputError) or keys.keys() <= set(KEYS)
