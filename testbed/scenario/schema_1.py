"""Names in schema 2 of the keys and values of schema 1."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from testbed.scenario.problems import Problem
from testbed.scenario.yaml_io import Node


@dataclass(frozen=True, slots=True)
class Renamed:
    """A key of schema 1.

    Args:
        old: its path; `*` stands for one name or one index of a list.
        new: what to write in its place; empty if only values were renamed.
        values: new values by old value.
        certain: false if the value alone does not show a file of schema 1.
    """

    old: str
    new: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    certain: bool = True


_AIRCRAFT = ("leader", "fleet", "fleet.*", "fleet.agents.*")
_LINKS = ("network", "network.links.*.*")

SCENARIO: tuple[Renamed, ...] = (
    Renamed("scenario.portions", "windows"),
    *(
        renamed
        for aircraft in _AIRCRAFT
        for renamed in (
            Renamed(f"{aircraft}.vehicle", values={"ideal": "unicycle"}),
            Renamed(f"{aircraft}.autopilot.patience_s", "timeout_s"),
            Renamed(f"{aircraft}.commanded_by.patience_s", "timeout_s"),
            Renamed(f"{aircraft}.sensors.like", "preset"),
            Renamed(f"{aircraft}.faults.*.kind", values={"radio-mute": "transmitter-off"}),
            Renamed(f"{aircraft}.faults.*.lasts_s", "duration_s"),
            Renamed(f"{aircraft}.faults.*.left", "remaining"),
        )
    ),
    Renamed("fleet.among", "neighbours_from"),
    Renamed(
        "formation.on_failure.answer",
        "response",
        {"fly-on": "ignore", "re-slot": "reassign-slots"},
    ),
    Renamed("formation.on_failure.after_s", "declared_after_s"),
    Renamed("formation.on_failure.clear_m", "clearance_m"),
    Renamed("controller.law", values={"paper": "hbh23"}),
    Renamed("controller.profile", values={"paper": "tuned"}, certain=False),
    Renamed("controller.bounds_of", "bounded_speed"),
    Renamed("controller.estimators.leader_acceleration", values={"turn": "coordinated_turn"}),
    Renamed("controller.estimators.turn_acceleration", "leader_angular_acceleration"),
    Renamed(
        "controller.silence", "controller.leader_timeout_s, on_leader_timeout and loiter_bank_deg"
    ),
    Renamed("controller.silence.after_s", "controller.leader_timeout_s"),
    Renamed("controller.silence.then", "controller.on_leader_timeout"),
    Renamed("controller.silence.bank_deg", "controller.loiter_bank_deg"),
    Renamed("controller.staleness", "controller.neighbour_timeout_s and on_neighbour_timeout"),
    Renamed("controller.staleness.after_s", "controller.neighbour_timeout_s"),
    Renamed(
        "controller.staleness.then",
        "controller.on_neighbour_timeout",
        {"hold": "hold-relative-position"},
    ),
    Renamed("network.hears", "receive", {"heeded": "neighbours"}),
    Renamed("network.mute_s", "transmitter_off_s"),
    *(Renamed(f"{link}.trace.shifted", "random_start") for link in _LINKS),
    Renamed("air.wind.longest_gap_s", "max_gap_s"),
    Renamed("air.gusts.*.kind", values={"place": "front"}),
    Renamed("limits.formation_m", "formation_lost_m"),
    Renamed("limits.when_lost", "on_loss", {"fly-on": "continue"}),
    Renamed("limits.when_upset", "on_limit_exceeded", {"fly-on": "continue"}),
)

MIDDLE_LOOP: tuple[Renamed, ...] = (
    Renamed("*.estimators.leader_acceleration", values={"turn": "coordinated_turn"}),
    Renamed("*.estimators.turn_acceleration", "leader_angular_acceleration"),
)


def renamed_keys(tree: Node, table: Sequence[Renamed] = SCENARIO) -> list[Problem]:
    """List the keys and values of schema 1 in one file or setting.

    Args:
        tree: the file, before it is merged with the one that it extends.
        table: renames that apply to this kind of file.

    Returns:
        one problem per key, with its place and what to write; empty for a file of schema 2.
    """
    found = [
        (problem, row.certain)
        for row in table
        for path, node in _matches(tree, tuple(row.old.split(".")))
        if (problem := _problem(row, path, node))
    ]
    for _, version in _matches(tree, ("scenario", "schema")):
        if version.value == 1:
            text = "is 1, and schema 2 is read (write 2, and the new names of the keys listed here)"
            found.append((Problem(version.place, text, ("scenario", "schema")), True))
    if not any(certain for _, certain in found):
        return []
    parents = {problem.path[:-1] for problem, _ in found}  # whose keys are named one by one
    return sorted((p for p, _ in found if p.path not in parents), key=_reading_order)


def _problem(row: Renamed, path: tuple[str, ...], node: Node) -> Problem | None:
    value = node.value if isinstance(node.value, str) else ""
    new = row.values.get(value)
    if row.new:
        wanted = f"{row.new}: {new}" if new else row.new
        return Problem(node.key, f"has another name in schema 2 (write {wanted})", path)
    if new:
        return Problem(node.place, f"is {value!r}, which is {new} in schema 2 (write {new})", path)
    return None


def _matches(
    node: Node, parts: tuple[str, ...], path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Node]]:
    """Yield every path and node that a pattern of keys names."""
    if not parts:
        yield path, node
        return
    children: dict[str, Node] = {}
    if isinstance(node.value, dict):
        children = node.value
    elif isinstance(node.value, tuple):
        children = {str(index): child for index, child in enumerate(node.value)}
    for name, child in children.items():
        if parts[0] in ("*", name):
            yield from _matches(child, parts[1:], (*path, name))


def _reading_order(problem: Problem) -> tuple[int, int]:
    return (problem.place.line, problem.place.column) if problem.place else (0, 0)
