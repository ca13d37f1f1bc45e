"""Layouts for Foxglove and PlotJuggler name fields that the log has; its frames form one tree."""

import json
import os
import re
import xml.etree.ElementTree as xml
from operator import attrgetter
from pathlib import Path

import foxglove.layouts as sdk
import numpy as np
import pytest
from commands import call_command
from google.protobuf import descriptor_pool
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from record_flight import decoded, record, run_info, run_samples

import testbed
from testbed.core.flags import LimiterFlag, Saturation
from testbed.logs.mcap_file import topic_schema
from testbed.logs.messages import FORMATION, QUANTITIES
from testbed.views.foxglove_layout import foxglove_layout
from testbed.views.foxglove_scene import FRAMES, TOPICS
from testbed.views.log_plots import numeric_topics, tabs
from testbed.views.plotjuggler_layout import plotjuggler_layout
from testbed.views.quantities import DEGREES, PLOTTED

SAMPLES = 30
# Foxglove's message path: topic, quoted if it has other characters; fields
PATH = re.compile(r'(?:"(?P<quoted>[^"]+)"|(?P<plain>[\w/-]+))\.(?P<fields>\w+(?:\.\w+)?)')
FLEETS = {
    "one": ("leader",),
    "four": ("leader", "uav1", "uav2", "uav3"),
    "odd names": ("lead-1", "a.b", "7_x"),
    "twenty": ("leader", *(f"uav{i}" for i in range(1, 20))),
}


@pytest.fixture(scope="module", params=FLEETS, ids=lambda name: name.replace(" ", "-"))
def path(request, tmp_path_factory):
    names = FLEETS[request.param]
    info = run_info(len(names) - 1, names=names)
    folder = tmp_path_factory.mktemp("run")
    seen = run_samples(SAMPLES, len(names) - 1, noisy_from=0)
    return record(folder / "run.mcap", seen, info)


@pytest.fixture(scope="module")
def messages(path):
    """Decode the log with its own schemas: messages by topic."""
    found = {}
    for topic, stamp, message in decoded(path):
        found.setdefault(topic, []).append((stamp, message))
    return found


@pytest.fixture(scope="module")
def layout(path):
    return json.loads(foxglove_layout(testbed.load_run(path).info))


def panels_in(tree):
    if isinstance(tree, str):
        return [tree]
    assert tree["direction"] in ("row", "column")
    assert 0 < tree["splitPercentage"] < 100
    return panels_in(tree["first"]) + panels_in(tree["second"])


def test_foxglove_layout_shows_every_panel_once(layout):
    panels = layout["configById"]
    shown = panels_in(layout["layout"])
    for tab in panels["Tab!plots"]["tabs"]:
        shown += panels_in(tab["layout"])
    assert sorted(shown) == sorted(panels)
    assert {name.partition("!")[0] for name in shown} == {"3D", "RosOut", "Tab", "Plot", "map"}


def test_foxglove_plots_name_fields_of_log(layout, messages):
    plotted = [
        series["value"]
        for name, panel in layout["configById"].items()
        if name.startswith("Plot!")
        for series in panel["paths"]
    ]
    assert plotted
    for value in plotted:
        found = PATH.fullmatch(value)
        assert found, value
        _, message = messages[found["quoted"] or found["plain"]][0]
        assert isinstance(attrgetter(found["fields"])(message), float | int), value


def test_foxglove_panels_name_topics_and_frames_of_log(layout, messages):
    panels = layout["configById"]
    frames = {t.child_frame_id for _, each in messages["/tf"] for t in each.transforms}
    [(_, static)] = messages["/tf_static"]
    assert panels["3D!world"]["followTf"] in frames
    assert panels["3D!world"]["fixedFrame"] == static.transforms[0].parent_frame_id
    fixes = {topic for topic in messages if topic.endswith("/fix")}
    assert set(panels["map!fixes"]["topicColors"]) == fixes
    assert panels["map!fixes"]["followTopic"] in fixes


def test_foxglove_settings_are_known_to_sdk(layout):
    """The SDK's panel types list all settings except the titles."""
    known = {
        "3D": set(sdk.ThreeDeeConfig()._to_dict()),
        "Plot": set(sdk.PlotConfig()._to_dict()) | {"foxglovePanelTitle", "lichtblickPanelTitle"},
        "RosOut": set(sdk.LogConfig()._to_dict()),
        "map": set(sdk.MapConfig()._to_dict()),
        "Tab": {"activeTabIdx", "tabs"},
    }
    series = set(sdk.PlotSeries()._to_dict())
    camera = set(sdk.ThreeDeeCameraState()._to_dict())
    shown = set(sdk.BaseRendererTransforms()._to_dict()) | {"axisScale"}
    grid = set(sdk.BaseRendererGridLayerSettings()._to_dict())
    for name, panel in layout["configById"].items():
        assert set(panel) <= known[name.partition("!")[0]], name
        for each in panel.get("paths", ()):
            assert set(each) <= series
    world = layout["configById"]["3D!world"]
    scene = set(sdk.BaseRendererSceneUpdateTopicSettings()._to_dict())
    for settings in world["topics"].values():
        assert set(settings) <= scene
    assert set(world["topics"]) == set(TOPICS) - {FRAMES}
    assert set(world["cameraState"]) <= camera
    assert set(world["scene"]["transforms"]) <= shown
    assert set(world["layers"]["ground"]) <= grid


def test_foxglove_grid_covers_path_in_100_m_squares():
    path = np.array([[0.0, 0.0, -100.0], [1230.0, -40.0, -100.0], [1230.0, 700.0, -90.0]])
    ground = json.loads(foxglove_layout(run_info(leader_path_ned=path)))
    ground = ground["configById"]["3D!world"]["layers"]["ground"]
    assert ground["size"] == 100 * ground["divisions"]
    east, north, up = ground["position"]
    half = ground["size"] / 2
    assert up == 0
    assert north - half <= 0 and 1230 <= north + half
    assert east - half <= -40 and 700 <= east + half


def plotjuggler_series(messages):
    """Name series as PlotJuggler does: `<topic>/<field>`, `<topic>/<field>/<field>` if nested."""
    found = {}
    for topic, each in messages.items():
        for _, message in each:
            for field in message.DESCRIPTOR.fields:
                value = getattr(message, field.name)
                if isinstance(value, float | int):
                    found.setdefault(f"{topic}/{field.name}", []).append(value)
                elif field.message_type and field.message_type.containing_type:
                    for each in field.message_type.fields:
                        name = f"{topic}/{field.name}/{each.name}"
                        found.setdefault(name, []).append(getattr(value, each.name))
    return found


def test_plotjuggler_axes_contain_every_curve(path, messages):
    series = plotjuggler_series(messages)
    root = xml.fromstring(plotjuggler_layout(testbed.load_run(path), path.name))
    selected = root.find("previouslyLoaded_Datafiles/fileInfo/plugin/parameters")
    chosen = set(selected.get("selected_topics").split(";"))
    plots = list(root.iter("plot"))
    assert plots
    for plot in plots:
        sides = {side: float(value) for side, value in plot.find("range").items()}
        assert (sides["left"], sides["right"]) == (0.0, 1.16)  # 30 samples at 25 Hz
        curves = [curve.get("name") for curve in plot.iter("curve")]
        values = np.concatenate([series[name] for name in curves])
        assert sides["bottom"] < np.nanmin(values) and np.nanmax(values) < sides["top"]
        assert {"/".join(name.split("/")[:3]) for name in curves} <= chosen


def test_plotjuggler_splitter_counts_match(path):
    root = xml.fromstring(plotjuggler_layout(testbed.load_run(path), path.name))
    for splitter in root.iter("DockSplitter"):
        assert int(splitter.get("count")) == len(splitter) == len(splitter.get("sizes").split(";"))
    assert len(list(root.iter("Tab"))) >= 2


def test_plotjuggler_selects_numeric_topics_of_log(path, messages):
    names = testbed.load_run(path).names
    assert set(numeric_topics(names)) <= set(messages)
    for topic in numeric_topics(names):
        fields = {field.name for field in messages[topic][0][1].DESCRIPTOR.fields}
        assert "timestamp" not in fields


def test_plotted_quantities_name_fields_of_log():
    for name, quantity in PLOTTED.items():
        assert {*quantity.fields, quantity.desired} <= {*QUANTITIES, ""}, name
        assert quantity.fields or not quantity.tab, name
        units = {QUANTITIES[field].unit for field in (*quantity.fields, quantity.desired) if field}
        assert units <= {"rad" if quantity.unit == DEGREES else quantity.unit}, name


@pytest.mark.parametrize("field, kind", [("limiter", LimiterFlag), ("saturation", Saturation)])
def test_bits_are_named_in_plots_and_schema(field, kind):
    """The plot's title has each value with its name, and the log's schema an enumeration."""
    names = ("leader", "uav1")
    title = next(title for title in tabs(names)["limits"] if field in title)
    pool = descriptor_pool.DescriptorPool()
    schema = topic_schema(FORMATION, names)
    for file in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    described = pool.FindMessageTypeByName(schema.name)
    enumeration = described.enum_types_by_name[f"{field.title()}Bits"].values_by_number
    assert sorted(enumeration) == [0, *(int(each) for each in kind)]
    for bit in kind:
        words = bit.name.lower()
        assert f"{int(bit)}: {words.replace('_', ' ')}" in title
        assert enumeration[int(bit)].name == f"{field}_bits_{words}".upper()


def test_legend_names_commands_as_the_title():
    for tab in tabs(("leader", "uav1")).values():
        for title, curves in tab.items():
            words = {each.label.partition(", ")[2] for each in curves if each.dashed}
            assert words == {word for word in ("commanded", "desired") if f"and {word}" in title}


def test_plotjuggler_layout_names_log_relative(tmp_path, path):
    made = tmp_path / "elsewhere.xml"
    arguments = ("export", path, "--format", "plotjuggler", "--out", made)
    call_command(*arguments, cwd=tmp_path, code=0, columns=120)
    named = xml.parse(made).find("previouslyLoaded_Datafiles/fileInfo").get("filename")
    assert not Path(named).is_absolute()
    assert (made.parent / named).resolve() == path.resolve()


def test_plotjuggler_layout_of_names_with_slashes(tmp_path):
    """A scenario may have them, and so may the path of the log that is no UTF-8."""
    log = tmp_path / os.fsdecode(b"\xff") / "run.mcap"
    log.parent.mkdir()
    record(log, run_samples(3), run_info(names=("a/leader", "/uav1", "u/a/v", "uav3/")))
    call_command("export", log, "--format", "plotjuggler", cwd=tmp_path, code=0, columns=120)
    curves = xml.parse(log.with_suffix(".plotjuggler.xml")).iter("curve")
    assert "//uav1/state/airspeed_mps" in {each.get("name") for each in curves}


def test_every_frame_has_root_enu_from_first_sample(path, messages):
    names = testbed.load_run(path).names
    for stamp, each in messages["/tf"]:
        parents = {t.child_frame_id: t.parent_frame_id for t in each.transforms}
        parents |= {
            t.child_frame_id: t.parent_frame_id for t in messages["/tf_static"][0][1].transforms
        }
        assert messages["/tf_static"][0][0] <= stamp
        for name in names:
            chain = [name]
            while chain[-1] in parents:
                assert len(chain) <= len(parents)
                chain.append(parents[chain[-1]])
            assert chain == [name, "ned", "enu"]
    for topic, found in messages.items():
        if topic.endswith("/fix"):
            assert {fix.frame_id for _, fix in found} == {topic.split("/")[1]}
