"""Kernels of the network with the arguments of the numpy reference."""

import numpy as np

from testbed.core.records import MESSAGE, allocate
from testbed.network.channel import initial_departures, initial_links, initial_transmitters
from testbed.network.packet_outcomes import transmit_broadcast


class KernelChannel:
    """A channel by the kernels: `packet_outcomes` has the arguments of the reference."""

    def __init__(self, channel):
        n, aircraft = channel.links.shape
        self.channel, self.links = channel, initial_links(channel)
        self.departures_s = initial_departures(channel)
        self.transmitters = initial_transmitters(aircraft)

    def packet_outcomes(self, rows, numbers, sent_s, scripted, trace_delay_s, fading):
        aircraft = len(self.transmitters)
        senders, times = np.zeros(aircraft, dtype=bool), np.zeros(aircraft)
        senders[rows], times[rows] = True, sent_s
        packets = self.links["packet"]
        packets["scripted"][:, rows] = scripted
        packets["trace_delay_s"][:, rows], packets["fading"][:, rows] = trace_delay_s, fading
        self.transmitters["number"][rows] = np.asarray(numbers) - 1
        transmit_broadcast(
            self.links,
            self.departures_s,
            self.channel.tables,
            self.transmitters,
            senders,
            np.zeros(aircraft, dtype=bool),
            times,
            allocate(MESSAGE, aircraft),
        )
        return packets["arrival_s"][:, rows], packets["outcome"][:, rows]

    @property
    def corrupted_s(self):
        return np.array(self.links["packet"]["corrupted_s"])
