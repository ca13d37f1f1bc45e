"""The loop of a companion: own state in, messages of others in, message and command out.

One `select` waits for the autopilot and the formation; there is no thread. A sample of the own
state ends with ATTITUDE: it is broadcast, and while the aircraft is engaged law and middle loop
step once for it and their command is sent.
"""

from __future__ import annotations

import math
import select
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from testbed.companion.autopilot_requests import AutopilotRequests, heartbeat
from testbed.companion.autopilot_state import IMU as IMU_MESSAGE
from testbed.companion.autopilot_state import OWN_STATE_MESSAGES, AutopilotState
from testbed.companion.boot_clock import BootClock, monotonic_of
from testbed.companion.engagement import CompanionText, Decision, EngagementState
from testbed.companion.follower_control import FollowerControl
from testbed.companion.formation_inbox import FormationInbox
from testbed.companion.formation_link import FormationLink
from testbed.companion.formation_messages import (
    NAME,
    FormationMessages,
)
from testbed.companion.loop_statistics import LoopStatistics
from testbed.companion.observation import Observation
from testbed.companion.scenario_digest import (
    AGREED_PARAMETERS,
    UNREAD,
    join_digests,
    parameter_digest,
)
from testbed.flight.own_state import IMU
from testbed.link.ends import End
from testbed.mavlink.codec import Codec, Message
from testbed.mavlink.lockstep_messages import RECEIPT, receipt_time
from testbed.mavlink.outgoing import Severity, StatusTexts
from testbed.mavlink.signing import MessageSigner, signing_time

COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
PIECES = 64  # of the autopilot at one read
WAIT_S = 0.05  # longest wait, so that it decides 20 times a second whatever comes
DECIDE_S = 0.04  # between decisions without a new sample
IGNORED_RATES = 7  # type_mask of SET_ATTITUDE_TARGET: attitude and thrust count
ANNOUNCE_S = 0.2  # between HEARTBEATs to a hub, until the autopilot sends
ANSWERED_S = 1.0  # in lockstep: after this wall time a sample that waits is broadcast again
MS = 1000.0  # of a second; a division gives the digits of a run


class Gate(Protocol):
    """Decides when the aircraft is commanded."""

    def step(self, seen: Observation) -> Decision:
        """Decide after an observation."""

    @property
    def may_end(self) -> bool:
        """Whether the process may end."""


class FixedGate:
    """Decide the same whatever is observed.

    Args:
        commands: of a simulated aircraft, from the first sample on; else never, as of a leader,
            whose state is broadcast.
    """

    may_end = True

    def __init__(self, *, commands: bool) -> None:
        state = EngagementState.ENGAGED if commands else EngagementState.WAITING
        self._decision = Decision(state, commands, None, (), ())

    def step(self, seen: Observation) -> Decision:
        """Return the decision."""
        return self._decision


class FlightListener(Protocol):
    """Takes what happens in the loop."""

    def sample(self, loop: CompanionLoop) -> None:
        """Take a sample of the own state, after its command."""

    def text(self, boot_s: float, text: CompanionText) -> None:
        """Take a text for the pilot."""

    def alive(self, now_s: float) -> None:
        """Note that the loop runs, at a time of the monotonic clock, s."""


@dataclass(frozen=True, slots=True)
class CompanionLinks:
    """Open links of a companion.

    Attributes:
        autopilot: its end.
        formation: to the others.
        stream: the autopilot is at a line of bytes.
        autopilot_signer: signs and verifies frames of the autopilot; None: unsigned.
        formation_signer: the same of the others.
    """

    autopilot: End
    formation: FormationLink
    stream: bool
    autopilot_signer: MessageSigner | None = None
    formation_signer: MessageSigner | None = None


class CompanionLoop:
    """Fly one aircraft of a formation.

    Attributes:
        control: law and middle loop; its records are what is known.
        state: of the autopilot.
        boot_s: time of the newest sample, s since the autopilot's boot.
        command: whether the newest sample was answered by a command.
        statistics: of the loop.
        errors: of the law; the first one ends the engagement.
    """

    def __init__(
        self,
        control: FollowerControl,
        links: CompanionLinks,
        gate: Gate,
        scenario: int,
        listeners: Sequence[FlightListener] = (),
        *,
        lockstep: bool = False,
        notices: Sequence[CompanionText] = (),
    ) -> None:
        """Prepare; nothing is sent before `run`.

        Args:
            control: of the aircraft.
            links: open ones.
            gate: decides when the aircraft is commanded.
            scenario: digest of the scenario.
            listeners: take what happens.
            lockstep: a step waits for the messages of its sample, and a run waits for the command.
            notices: sent once, with the first sample.
        """
        self.control, self._links, self._gate, self._scenario_digest = (
            control,
            links,
            gate,
            scenario,
        )
        self._listeners, self._lockstep = tuple(listeners), lockstep
        self._notices = list(notices)
        row, names = control.row, control.plan.names
        self._names = names
        system = row + 1
        self._autopilot = Codec(system, COMPONENT, links.autopilot_signer)
        self._formation = Codec(system, COMPONENT, links.formation_signer)
        self.state, self._clock = AutopilotState(system), BootClock()
        streams: tuple[str, ...] = OWN_STATE_MESSAGES
        if control.acceleration == IMU:
            streams = IMU_MESSAGE, *streams
        self._requests = AutopilotRequests(
            self._autopilot, system, streams, control.rate_hz, AGREED_PARAMETERS
        )
        self._messages = FormationMessages(control.plan.origin, len(names))
        self._texts = StatusTexts()
        self._target = {"target_system": system, "target_component": 1}
        self.boot_s, self.command = -math.inf, False
        self._digested, self._joined = (-1, False), 0  # parameters, and `custom_state` of them
        self._base_ms: int | None = None  # of the times of messages
        self._sample_received_s = 0.0
        self._answer = b""  # to the newest sample
        self._broadcast = b""  # of the newest sample
        self._waiting = False  # in lockstep: for the messages of the newest sample
        self._mark_ms = -1  # in lockstep: all messages up to this time have come
        self._receipt_s: float | None = None  # of the next message, by the hub
        self._inbox = FormationInbox(control, self._messages)
        self._decided_s = self._announced_s = -math.inf
        self._decision = Decision(EngagementState.WAITING, False, None, (), ())
        self._has_autopilot, self._reported_system = False, 0
        self.error: Exception | None = None
        self.statistics = LoopStatistics([names[m] for m in control.used])

    @property
    def rejected(self) -> Counter[str]:
        """Frames of the others that failed verification, by reason."""
        return Counter[str](self._formation.rejected)

    @property
    def decision(self) -> Decision:
        """The newest decision."""
        return self._decision

    def run(self, stop: Callable[[], bool]) -> None:
        """Fly until a stop is requested and the aircraft is left.

        Args:
            stop: whether a stop is requested.

        Raises:
            ExternalProgramLost: the autopilot's device is gone.
        """
        while True:
            stopping = stop()
            self.turn(stopping=stopping)
            if stopping and self._gate.may_end:
                return

    def turn(self, *, stopping: bool = False) -> None:
        """Wait for what comes, at most 0.05 s, and handle it.

        Args:
            stopping: the process is to end, and the aircraft to be left.

        Raises:
            ExternalProgramLost: the autopilot's device is gone.
        """
        if not self._has_autopilot and time.monotonic() - self._announced_s >= ANNOUNCE_S:
            self._announced_s = time.monotonic()
            self._announce()
        ends = self._links.autopilot, self._links.formation
        full = [self._links.autopilot] if self._links.autopilot.has_output else []
        ready, _, _ = select.select(ends, full, [], WAIT_S)
        if full:
            self._links.autopilot.flush()
        if self._links.formation in ready:
            self._read_formation()
        if self._links.autopilot in ready:
            self._read_autopilot()
        now_s = time.monotonic()
        if self._has_autopilot:
            for frame in self._requests.due(self.state, now_s):
                self._send(frame)
        self._answer_waiting()
        for listener in self._listeners:
            listener.alive(now_s)
        if stopping or now_s - self._decided_s >= DECIDE_S:
            self._decide(now_s, stopping=stopping)

    def _announce(self) -> None:
        """Send a HEARTBEAT to a hub, which replies to this address from then on."""
        if self._links.formation.address.kind == "hub":
            self._links.formation.send(heartbeat(self._formation))

    def _send(self, frame: bytes) -> None:
        self._links.autopilot.send(frame)

    def _read_autopilot(self) -> None:
        datagrams = not self._links.stream
        ended_s: float | None = None  # receipt of the end of a sample
        for data, stamp_ns in self._links.autopilot.receive(PIECES):
            now_s = time.monotonic()
            received_s = monotonic_of(stamp_ns, now_s)
            for message in self._autopilot.feed(data, datagram=datagrams):
                if self.state.add(message, received_s):
                    ended_s = received_s
                elif message.name == "HEARTBEAT" and message.component == 1:
                    self._decided_s = -math.inf  # the mode may have changed
                    self._check_system()
            self._has_autopilot = True
        if ended_s is not None:  # of several that have waited, the newest alone is answered
            self._take_attitude(ended_s)

    def _check_system(self) -> None:
        """Report once that the link has the autopilot of another aircraft only."""
        other = self.state.other_system
        if not other or self.state.mode is not None or self._reported_system == other:
            return
        self._reported_system = other
        own = self.control.row + 1
        self.send_text(
            CompanionText(Severity.ERROR, f"autopilot has system id {other}, {own} is expected")
        )

    def _take_attitude(self, received_s: float) -> None:
        """Take the end of a sample."""
        state = self.state
        if state.boot_ms is None or not state.has_own_state:
            return
        boot_s = state.boot_ms / MS
        if boot_s == self.boot_s:  # a run repeats a sample that it waits for
            self._repeat()
            return
        if boot_s < self.boot_s:
            self._clock.restart()
            self._requests.restart()
        if state.base_ms != self._base_ms:  # their times count from another moment
            self._base_ms = state.base_ms
            self._inbox.forget()
        self._advance_signers()
        for frame in self._requests.due(state, time.monotonic()):  # before a run goes on
            self._send(frame)
        self.boot_s, self._sample_received_s = boot_s, received_s
        self._clock.add(boot_s, received_s)
        self.statistics.samples += 1
        ahead_ms = state.boot_ms - state.position_ms
        self.control.take_own_state(state.own, ahead_ms / MS if abs(ahead_ms) < 500 else 0.0)
        self.command, self._answer, self._waiting = False, b"", self._lockstep
        self._send_message()
        while self._notices:
            self.send_text(self._notices.pop(0))
        if not self._lockstep:
            self._read_formation()
            self._decide(time.monotonic())
            self._read_formation()  # others broadcast the same sample meanwhile
            self._take_messages()
            self._fly(self._clock.at(time.monotonic()))
            self._tell_sample()

    def _repeat(self) -> None:
        """Send again what was sent for a sample: nothing is stepped twice."""
        if not self._lockstep:
            return
        if self._answer:
            self._send(self._answer)
        elif self._broadcast:
            self._links.formation.send(self._broadcast)

    def _send_message(self) -> None:
        """Broadcast the own state, if the GPS time is known."""
        base_ms, boot_ms = self.state.base_ms, self.state.boot_ms
        if base_ms is None or boot_ms is None or base_ms + boot_ms < 0:
            return
        message = self.control.message(self.boot_s)
        fields = self._messages.fields(message, base_ms + boot_ms, self._digests())
        self._broadcast = self._formation.pack(NAME, **fields)
        self._links.formation.send(self._broadcast)

    def _digests(self) -> int:
        known = self.state.counts.get("PARAM_VALUE", 0), self._requests.has_read(self.state)
        if known != self._digested:  # parameters that have come since
            self._digested = known
            parameters = parameter_digest(self.state.parameters) if known[1] else UNREAD
            self._joined = join_digests(self._scenario_digest, parameters)
        return self._joined

    def _read_formation(self) -> None:
        for data, stamp_ns in self._links.formation.receive():
            received_s = monotonic_of(stamp_ns, time.monotonic())
            for message in self._formation.feed(data, datagram=True):
                self._take_formation(message, received_s)

    def _take_formation(self, message: Message, received_s: float) -> None:
        if self._lockstep and self._links.formation.address.kind == "hub":
            if message.name == "SYSTEM_TIME":
                self._mark_ms = int(message.number("time_boot_ms"))
                return
            if message.name == RECEIPT:
                self._receipt_s = receipt_time(message.fields["data"])
                return
        self._inbox.add(message, received_s, self._receipt_s)

    def _take_messages(self) -> None:
        """Read the messages of others that have come."""
        self._inbox.take(self._base_ms, None if self._lockstep else self._clock.at)

    def _answer_waiting(self) -> None:
        """In lockstep step as soon as all messages of the newest sample have come."""
        if not self._waiting:
            return
        if self._links.formation.address.kind == "hub":
            complete = self.state.boot_ms is not None and self._mark_ms >= self.state.boot_ms
        else:
            self._take_messages()
            inbox = self.control.inbox
            complete = all(inbox[m]["stamp_s"] >= self.boot_s - 1e-9 for m in self.control.used)
        if complete:
            self._waiting = False
            self._decide(time.monotonic())
            self._fly(self.boot_s)
            self._tell_sample()

    def _decide(self, now_s: float, *, stopping: bool = False) -> None:
        """Observe, and do what the gate decides."""
        self._take_messages()
        self._decided_s = now_s
        engaged = self._decision.command
        decision = self._decision = self._gate.step(self.observe(now_s, stopping=stopping))
        if decision.command and not engaged and self.control.row:
            self.control.restart()
        if decision.change_mode is not None:
            self._send(self._requests.change_mode(int(decision.change_mode)))
        for text in decision.texts:
            self.send_text(text)

    def observe(self, now_s: float, *, stopping: bool = False) -> Observation:
        """Return what is known at a time, s of the monotonic clock."""
        state, estimate = self.state, self.control.own["estimate"]
        known = state.has_own_state
        origin = self.control.plan.origin
        position = tuple(estimate["position_ned"].tolist()) if known else _UNKNOWN
        return Observation(
            now_s=self.boot_s if self._lockstep else now_s,
            boot_s=self.boot_s if math.isfinite(self.boot_s) else None,
            ages_s={name: now_s - at for name, at in state.received_s.items()},
            mode=state.mode,
            armed=state.armed,
            ekf_flags=state.ekf_flags,
            ekf_variances=state.ekf_variances,
            fix_type=state.fix_type,
            airspeed_mps=float(estimate["equivalent_airspeed"]) if known else math.nan,
            position_ned=position,
            velocity_ned=tuple(estimate["velocity_ned"].tolist()) if known else _UNKNOWN,
            height_m=origin.elevation_m - position[2],
            base_ms=state.base_ms,
            sticks_us=state.sticks_us,
            parameters=state.parameters,
            digests=self._digests(),
            peers=self._inbox.observed(now_s),
            stopping=stopping or self.error is not None,
        )

    def send_text(self, text: CompanionText) -> None:
        """Send a text to the ground station, and to the listeners."""
        for each in self._texts.make_text(text.severity, text.text):
            self._send(self._autopilot.pack(each.name, **each.fields))
        for listener in self._listeners:
            listener.text(max(self.boot_s, 0.0), text)

    def _fly(self, now: float) -> None:
        """Step law and middle loop at a time, s since boot, and send their command."""
        control = self.control
        if self._decision.command and control.row and self.error is None:
            self._command(now)

    def _tell_sample(self) -> None:
        for listener in self._listeners:
            listener.sample(self)

    def _command(self, now: float) -> None:
        control, statistics = self.control, self.statistics
        begun_s = time.perf_counter()
        try:
            control.step(now)
        except Exception as error:  # of a law in Python: the aircraft is left in order
            self.error = error
            self.send_text(CompanionText(Severity.ERROR, f"formation: the law failed: {error}"))
            return
        statistics.step.add(time.perf_counter() - begun_s)
        target = control.target()
        self._answer = self._autopilot.pack(
            "SET_ATTITUDE_TARGET",
            time_boot_ms=self.state.boot_ms or 0,
            type_mask=IGNORED_RATES,
            q=target["q"].tolist(),
            body_roll_rate=0.0,
            body_pitch_rate=0.0,
            body_yaw_rate=0.0,
            thrust=float(target["thrust"]),
            **self._target,
        )
        self._send(self._answer)
        self.command = True
        statistics.add_command(time.monotonic() - self._sample_received_s)
        for m in control.used:
            link = control.inbox[m]
            statistics.add_age(self._names[m], now - float(link["stamp_s"]))

    def _advance_signers(self) -> None:
        """Let signatures have the time: the later one of the system and of GPS.

        Many computers aboard start with a clock that is years late.
        """
        unix_s, base_ms = time.time(), self.state.base_ms
        if base_ms is not None and self.state.boot_ms is not None:
            unix_s = max(unix_s, (base_ms + self.state.boot_ms) / MS)
        time_10us = signing_time(unix_s)
        for signer in (self._links.autopilot_signer, self._links.formation_signer):
            if signer is not None:
                signer.advance(time_10us)


_UNKNOWN = (math.nan, math.nan, math.nan)
