"""A law of one's own, as the page everything.yaml names one: the paper's, but slower."""

from testbed.law import FormationConfig


class Slower:
    """The paper's law for the same followers, with a part of its speed taken away."""

    def __init__(
        self, config: FormationConfig, *, by_mps: float, axes: tuple, loud: bool, mark: str
    ):
        self.hbh23, self.by_mps = config.hbh23, by_mps
        self.rest = axes, loud, mark

    def start(self, own):
        return self.hbh23.start(own)

    def step(self, now, own, inbox, memory):
        told, memory = self.hbh23.step(now, own, inbox, memory)
        return told._replace(speed=told.speed - self.by_mps), memory
