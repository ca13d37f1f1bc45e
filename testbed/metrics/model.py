"""The metrics document: types of metrics.json, by which documents from logs are checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError

# pydantic takes none of `typing` before Python 3.12
from typing_extensions import NotRequired, TypedDict

from testbed.core.data_errors import MAX_WHOLE

_ValueT = TypeVar("_ValueT")

Number: TypeAlias = Annotated[float, Field(le=MAX_WHOLE, allow_inf_nan=False)]
Count: TypeAlias = Annotated[int, Field(ge=0, le=MAX_WHOLE)]
Known: TypeAlias = Number | None  # None: unknown
Pair: TypeAlias = Annotated[list[_ValueT], Field(min_length=2, max_length=2)]
Triple: TypeAlias = Annotated[list[_ValueT], Field(min_length=3, max_length=3)]


class _Keys:
    """Check that the keys of a map are the names of a kind in the run, in order."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def __call__(self, values: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        expected: Sequence[str] = (info.context or {})[self.kind]
        for name in expected:
            if name not in values:
                raise PydanticCustomError("key", "is missing", {"key": (name,)})
        if list(values) != list(expected):
            raise PydanticCustomError("keys", "its keys are not those of the run, in order")
        return values


def _keys(kind: str) -> AfterValidator:
    return AfterValidator(_Keys(kind))


@dataclass(frozen=True, slots=True)
class _PossibleKeys:
    """Note that a map has some of the names of a kind as keys."""

    kind: str


def key_kind(note: object) -> str:
    """Return of which kind the keys of a map are, by a note of its type; "" of none."""
    found = getattr(note, "func", note)
    return found.kind if isinstance(found, _Keys | _PossibleKeys) else ""


ByWindow = Annotated[dict[str, _ValueT], _keys("windows")]
ByAircraft = Annotated[dict[str, _ValueT], _keys("names")]
ByFollower = Annotated[dict[str, _ValueT], _keys("followers")]


class SlotSpeed(TypedDict):
    """Speeds of the slots."""

    kappa_mps: ByFollower[Known]
    slot_speed_mps: ByFollower[Pair[Known]]


class WindowMetrics(SlotSpeed):
    """Errors within a window of time."""

    window_s: Pair[Number]
    covered_s: Number
    complete: bool
    rms_m: ByFollower[Known]
    mean_rms_m: Known
    estimated_rms_m: ByFollower[Known]
    estimated_mean_rms_m: Known
    percent_error: Known
    max_error_m: ByFollower[Known]
    leader_bank_deg: Known
    min_separation_m: NotRequired[Known]  # earlier logs do not have it


class LimiterFlagCounts(TypedDict):
    """Samples in which limiters of the law acted."""

    samples: Count
    seconds: Known  # null: a recorded flight, whose law is not known
    # logs of earlier releases know fewer of them
    by_kind: Annotated[dict[str, Count], _PossibleKeys("limiter_flags")]


class SaturationCounts(TypedDict):
    """Samples in which commands were saturated."""

    samples: Count
    seconds: Known  # null: see above
    by_kind: Annotated[dict[str, Count], _keys("saturations")]


class RingingMetrics(TypedDict):
    """Oscillation of a follower's bank angle."""

    seconds: Known
    last_s: Known
    period_s: Known
    damping_ratio: Known


class SpeedSetExits(TypedDict):
    """How often a follower left its speed set."""

    times: Count
    first_s: Known


class RecoveryTimes(TypedDict):
    """When a follower was last saturated, and since when it is in its slot."""

    last_saturated_s: Known
    in_slot_since_s: Known


class MessageAge(TypedDict):
    """Age of the messages that a follower used."""

    mean: Known
    max: Known


class DelayStatistics(TypedDict):
    """Delays of the first copies received, s."""

    mean: Number
    min: Number
    max: Number
    p50: Number
    p95: Number
    p99: Number


class BurstStatistics(TypedDict):
    """Bursts of losses, packets."""

    count: Count
    mean: Known
    longest: Count
    lengths: dict[str, Count]


class AgeStatistics(TypedDict):
    """Ages of a link's messages at their uses, s."""

    mean: Number
    max: Number
    p50: Number
    p95: Number
    uses: Number


class LinkMetrics(TypedDict):
    """Statistics of one link, or of all together."""

    sent: Count
    delivered: Count
    delivered_share: Known
    lost: Annotated[dict[str, Count], _PossibleKeys("losses")]
    muted: Count
    duplicated: Count
    overtaken: Count
    delay_s: DelayStatistics | None
    bursts: BurstStatistics
    age_s: AgeStatistics | None


class NetworkMetrics(TypedDict):
    """Statistics of all links."""

    links: dict[str, dict[str, LinkMetrics]]  # by sender and receiver
    all: LinkMetrics


class WindMetrics(TypedDict):
    """Wind at one aircraft."""

    mean_ned_mps: Triple[Known]
    mean_mps: Known
    from_deg: Known
    gusts_rms_ned_mps: Triple[Known]
    max_mps: Known
    max_wake_delta_cl: Known


class EstimateErrorMetrics(TypedDict):
    """RMS of estimate minus truth of one aircraft."""

    horizontal_m: Known
    height_m: Known
    velocity_mps: Known
    tilt_deg: Known
    heading_deg: Known
    airspeed_mps: Known
    max_horizontal_m: Known


class PublishedNumbers(TypedDict):
    """Numbers published for the scenario, by window."""

    source: str
    rms_m: dict[str, list[Number]]
    mean_rms_m: dict[str, Number]
    percent_error: dict[str, Number]
    differs: NotRequired[list[str]]


class LoggedEvent(TypedDict):
    """An event of the run."""

    time_s: Number
    level: str
    source: str
    text: str


class TickLateness(TypedDict):
    """Lateness of ticks, s of wall-clock time."""

    mean: Number
    p99: Number
    max: Number


class PaceMetrics(TypedDict):
    """Requested and achieved pace of a run."""

    requested: Number
    achieved: Known
    late_s: TickLateness


class MavlinkTraffic(TypedDict):
    """Traffic over all MAVLink links."""

    frames_sent: Count
    frames_received: Count
    rejected: dict[str, Count]
    clients: list[str]


class ComparedBound(TypedDict):
    """A number of the run beside a bound of the scenario."""

    key: list[str]
    quantity: str
    window: str | None
    follower: str | None
    side: str
    bound: Number
    value: Known
    met: bool


class Expectations(TypedDict):
    """Comparison with the bounds of the scenario."""

    checked: Count
    violated: Count
    bounds: list[ComparedBound]


class Metrics(SlotSpeed):
    """The metrics of a run."""

    schema: int
    scenario: str
    seed: Count
    versions: dict[str, str]
    engine: NotRequired[Literal["compiled", "jsbsim"] | None]  # earlier logs do not have it
    outcome: str | None
    begin_s: NotRequired[Number]  # of a flight that begins as another one was then
    simulated_s: Number  # time of the last sample
    wall_s: Known
    real_time_factor: Known
    windows: ByWindow[WindowMetrics]
    min_separation_m: Known
    min_separation_at_s: Known
    min_separation_between: list[str] | None
    min_separation_outside_windows_m: NotRequired[Known]  # earlier logs do not have it
    lost_at_s: ByAircraft[Known]
    joined_at_s: ByFollower[Known]
    max_error_m: ByFollower[Known]
    leader_bank_deg: Known
    limiter_flags: ByFollower[LimiterFlagCounts]
    saturations: ByFollower[SaturationCounts]
    ringing: ByFollower[RingingMetrics]
    kappa_at_s: ByFollower[Known]
    kappa_assumed_mps: ByFollower[float]
    left_speed_set: ByFollower[SpeedSetExits]
    recovery: ByFollower[RecoveryTimes]
    age_of_information_s: ByFollower[MessageAge]
    network: NetworkMetrics | None
    mean_throttle: ByAircraft[Known]
    wind: ByAircraft[WindMetrics]
    estimate_error: ByAircraft[EstimateErrorMetrics]
    relative_position_error_m: ByFollower[Known]
    published: PublishedNumbers | None
    events: list[LoggedEvent]
    recovered: NotRequired[bool]  # of a run whose log was cut
    recorded: NotRequired[bool]  # of real aircraft: without law, messages and wind
    # of runs with external programs
    pace: NotRequired[PaceMetrics]
    mavlink: NotRequired[MavlinkTraffic]
    arduplane: NotRequired[dict[str, str]]
    commanded: NotRequired[dict[str, dict[str, Count]]]
    expect: NotRequired[Expectations]  # of scenarios with `expect`
