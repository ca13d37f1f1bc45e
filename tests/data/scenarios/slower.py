"""A law of one's own, as the page everything.yaml names one: the paper's, but slower."""

from testbed.law import Team


class Slower:
    """The paper's law for the same team, with a part of its speed taken away."""

    def __init__(self, team: Team, *, by_mps: float, axes: tuple, loud: bool, mark: str):
        self.paper, self.by_mps = team.paper, by_mps
        self.rest = axes, loud, mark

    def start(self, own):
        return self.paper.start(own)

    def step(self, now, own, inbox, memory):
        told, memory = self.paper.step(now, own, inbox, memory)
        return told._replace(speed=told.speed - self.by_mps), memory
