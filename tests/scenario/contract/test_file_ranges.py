"""Columns of files have the bounds of the keys in whose place they stand."""

import ast
import csv
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from places import TESTS

import testbed
from testbed.atmosphere import mean_wind
from testbed.commissioning import command_files
from testbed.core import ranges
from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.ranges import RECORDED, THROTTLE, TURN, WIND_COMPONENT, Range
from testbed.flight_logs import column_map
from testbed.flight_logs import recorded_motion as motion
from testbed.guidance import recorded_path
from testbed.network import channel, trace
from testbed.network.links import resolve_links
from testbed.scenario import MiddleLoopGains, load_scenario
from testbed.scenario.sections import Sections

PACKAGE = Path(testbed.__file__).parent
ROWS = 5


@cache
def schema_of(section):
    return section.model_json_schema()


def schema_bounds(section, path):
    """Return (minimum, maximum) of all numbers of a key, by the JSON schema of its section."""
    schema = schema_of(section)

    def resolved(node):
        while "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        return node

    def parts(node):
        node = resolved(node)
        below = [each for name in ("anyOf", "oneOf", "prefixItems") for each in node.get(name, ())]
        below += [node["items"]] if isinstance(node.get("items"), dict) else []
        return [node, *(part for each in below for part in parts(each))]

    nodes = [schema]
    for key in path:
        found = [each.get("properties", {}) for node in nodes for each in parts(node)]
        nodes = [each[key] for each in found if key in each]
    numbers = [each for node in nodes for each in parts(node) if each.get("type") == "number"]
    return {(each.get("minimum"), each.get("maximum")) for each in numbers}


KEYS = {name: each for name, each in vars(ranges).items() if isinstance(each, Range) and each.key}


@pytest.mark.parametrize("name", KEYS)
def test_range_is_that_of_its_key(name):
    limits, path = KEYS[name], KEYS[name].key.split(".")
    if limits is WIND_COMPONENT:  # of a speed, to both sides
        limits = Range(0.0, limits.high)
        assert KEYS[name].low == -limits.high
    section = Sections
    if path[:2] == ["controller", "gains"]:
        section, path = MiddleLoopGains, path[2:]
    assert schema_bounds(section, path) == {(limits.low, limits.high)}


def feed_wind(path):
    mean_wind.read_wind(path, 10.0, 0.1)


def feed_leader(path):
    recorded_path.read_recording(path)


def feed_commands(path):
    command_files.read_commands(path)


def feed_track(path):
    found = motion.read_csv(path)
    if wrong := motion.find_contradiction(found):
        raise InputError(f"{path}: {wrong[0]} {wrong[1]}")


def feed_trace(path):
    trace.TraceFile(path).trace("leader", "uav1")


def feed_delays(path):
    setting = f"network.jitter={{distribution: empirical, file: {path}}}"
    scenario = load_scenario("simulation-3", [setting, "network.delay_s=0.5"])
    channel.make_channel(resolve_links(scenario.aircraft_names, scenario.network), 1)


def feed_map(path):
    names = path.read_text(encoding="utf-8").splitlines()[0].split(",")
    units = {"deg": "deg", "": "share"}
    lines = [
        f"{name}: {{column: {name}, unit: {units.get(RECORDED[name].unit, RECORDED[name].unit)}}}"
        for name in names
    ]
    path.with_suffix(".yaml").write_text("\n".join(lines), encoding="utf-8")
    column_map.read_mapped(path, path.with_suffix(".yaml"))


def recorded(*names):
    return {name: RECORDED[name] for name in names}


MAPPED = [name for name in column_map.ColumnMap.model_fields if name in RECORDED]
TRACK = (*motion._COLUMNS, *motion.COMMANDS, *motion.PULSES)
# Module of a reader: what reads a file of it, and its columns with the columns beside each.
READERS = {
    "atmosphere/mean_wind.py": (feed_wind, mean_wind.COLUMNS),
    "guidance/recorded_path.py": (feed_leader, recorded(*recorded_path.COLUMNS)),
    "network/channel.py": (feed_delays, channel.COLUMNS),
    "network/trace.py": (feed_trace, trace.COLUMNS),
    "flight_logs/column_map.py": (feed_map, recorded(*MAPPED)),
    "flight_logs/recorded_motion.py": (feed_track, recorded(*TRACK)),
    "commissioning/command_files.py": (
        feed_commands,
        recorded(*command_files.COMMANDS, *command_files.RESPONSES),
    ),
}


def test_every_reader_of_tables_is_walked_over():
    """A new kind of file needs a row above; `CsvTable.numbers` reads no column without a range."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "csv_table" in text else ():
            if isinstance(node, ast.ImportFrom) and node.module == "testbed.core.csv_table":
                found.add(path.relative_to(PACKAGE).as_posix())
    assert found == READERS.keys()
    assert {*column_map.ColumnMap.model_fields} == {*MAPPED}
    with pytest.raises(AttributeError):
        read_table(TESTS / "data/arduplane_fbwa_rascal_steps.csv").numbers(("t_s",))


def beside(module, name):
    """Return the columns of a file in which this column is read."""
    columns = READERS[module][1]
    if module == "atmosphere/mean_wind.py":
        horizontal = next(
            (pair for pair in (mean_wind.BY_AXES, mean_wind.BY_DIRECTION) if name in pair),
            mean_wind.BY_AXES,
        )
        return ("t_s", *horizontal, *((name,) if name == mean_wind.DOWN else ()))
    if module == "flight_logs/column_map.py":  # a map refuses two positions
        needed = ("t_s", *motion.NED)
        if name in motion.POSITION:
            needed = ("t_s", *motion.POSITION)
        return tuple(dict.fromkeys((*needed, *motion.POLAR, name)))
    return tuple(columns)


CASES = [
    (module, name)
    for module, (_, columns) in READERS.items()
    for name, limits in columns.items()
    if math.isfinite(limits.high)
]


@pytest.mark.parametrize(("module", "name"), CASES)
def test_column_beyond_its_range_is_refused(module, name, tmp_path):
    """At the ends a file is read; beyond them the error names row, value and remedy."""
    feed, columns = READERS[module]
    limits, path, names = columns[name], tmp_path / "file.csv", beside(module, name)
    span = limits.high - limits.low

    def problem(value):
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(names)
            for k in range(ROWS):
                row = dict.fromkeys(names, 0.0) | {"t_s": 0.1 * k}
                row |= {each: 1.0 for each in motion.POSITION if each in names}
                row |= {name: value} if k == ROWS - 2 or value is None else {}
                writer.writerow(row[each] for each in names)
        try:
            feed(path)
        except InputError as error:
            return str(error)
        return ""

    within = (limits.low, limits.high, limits.high + 0.5 * limits.slack)
    for value in within:
        text = problem(value)
        assert "allowed are" not in text and " allows " not in text, text
        assert f"{name}: is up to" not in text and f"{name}: is down to" not in text, text
    beyond = 1.01 * limits.slack + 1e-3 * span
    for value in (limits.low - beyond, limits.high + beyond):
        text = problem(value)
        assert name in text and f"{value:g}" in text, text
        if feed is feed_map:
            assert "; write " in text and f"no_value: {value:g}" in text, text
            continue
        assert f"file.csv:{ROWS}: " in text and "remove the row" in text, text
        assert limits.key in text and f"{limits.high:.4g}" in text, text
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join(lines[: ROWS - 1] + lines[ROWS:]), encoding="utf-8")
        feed(path)  # the remedy


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_trace_of_two_clocks_is_refused(tmp_path):
    """An hour between sender and receiver; both remedies, and 60 s, are accepted."""
    head = "sent_s,received_s\n0,0.05\n"
    text = "t.csv:3: received 3600.04 s after it was sent, and network.delay_s allows up to 60 s: "
    remedy = "correct received_s by the difference of the clocks of sender and receiver, or leave"
    with pytest.raises(InputError, match=text + remedy):
        feed_trace(write(tmp_path / "t.csv", f"{head}0.02,3600.06\n0.04,3600.1\n"))
    for good in ("0.02,0.06\n0.04,0.1\n", "0.02,\n0.04,\n", "0.02,60.02\n0.04,60\n"):
        feed_trace(write(tmp_path / "t.csv", head + good))


def test_delays_above_those_of_the_key_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"d.csv:3: delay_s 3600 s plus the scenario's 0.5 s is"):
        feed_delays(write(tmp_path / "d.csv", "delay_s\n0.1\n3600\n0.2\n"))
    feed_delays(write(tmp_path / "d.csv", "delay_s\n0.1\n0.2\n"))  # without the row
    feed_delays(write(tmp_path / "d.csv", "delay_s\n0.1\n59.5\n"))
    with pytest.raises(InputError, match=r"d.csv:3: delay_s 59.6 s plus"):
        feed_delays(write(tmp_path / "d.csv", "delay_s\n0.1\n59.6\n"))


def test_wind_by_axes_has_the_bound_of_its_speed(tmp_path):
    wind = "t_s,north_mps,east_mps\n0,36,{}\n1,36,{}\n"
    feed_wind(write(tmp_path / "w.csv", wind.format(47.9, 48.0)))
    with pytest.raises(InputError, match=r"w.csv:3: horizontal speed is 60.08, and air.wind.speed"):
        feed_wind(write(tmp_path / "w.csv", wind.format(48, 48.1)))


def test_rounded_throttle_is_the_end(tmp_path):
    """100.4 % of a log that rounds is full throttle; 50 of a log in per cent is refused."""
    lines = ["t_s,theta_cmd_rad,phi_cmd_rad,throttle_cmd", "0,0,0,1.004", "1,0,0,0.5"]
    found = command_files.read_commands(write(tmp_path / "c.csv", "\n".join(lines)))
    assert found.values[:, 3].tolist() == [1.0, 0.5]
    assert THROTTLE.outside(np.array([50.0, -0.02, 1.02])).all()


def test_no_value_of_a_map_leaves_rows_out(tmp_path):
    """The error of 9999 offers the key; with it the row is left out, and only this one."""
    rows = [f"{k / 10},{2 * k / 10},0,0,{9999 if k == 3 else 0.1}" for k in range(10)]
    table = write(tmp_path / "t.csv", "\n".join(["t,n,e,d,r", *rows]))
    lines = [f"{a}: {{column: {b}}}" for a, b in zip(("t_s", *motion.NED), "tned", strict=True)]
    mapped = tmp_path / "map.yaml"
    write(mapped, "\n".join([*lines, "roll_rad: {column: r}"]))
    with pytest.raises(InputError, match="or no_value: 9999 if this stands for no value"):
        column_map.read_mapped(table, mapped)
    write(mapped, "\n".join([*lines, "roll_rad: {column: r, no_value: 9999}"]))
    found = column_map.read_mapped(table, mapped)
    assert found.columns["t_s"].tolist() == [k / 10 for k in range(10) if k != 3]
    assert found.notes == ("rows with no_value are left out: 1",)


def test_headings_of_formations_count_no_turns(tmp_path):
    """0 to 360° and −180° to 180° are both headings; 360 is degrees."""
    names = ("t_s", *motion.NED, "yaw_rad")
    for value in (-math.pi, 0.0, math.pi, 2.0 * math.pi):
        rows = [f"{k},0,0,0,{value}" for k in range(3)]
        feed_track(write(tmp_path / "t.csv", "\n".join([",".join(names), *rows])))
    rows = [f"{k},0,0,0,{TURN.high + 0.01}" for k in range(3)]
    with pytest.raises(InputError, match="yaw_rad is up to 6.29319, above 6.283; write unit: deg"):
        feed_track(write(tmp_path / "t.csv", "\n".join([",".join(names), *rows])))
