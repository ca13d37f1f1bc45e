"""From the text of a page to an immutable `Scenario`; what is wrong is named by line and column."""

from testbed.scenario.editor import json_schema
from testbed.scenario.gains import MiddleLoopGains
from testbed.scenario.load import dump, load, load_guidance, load_middle_loop, loads
from testbed.scenario.messages import Place, Problem, ScenarioError
from testbed.scenario.resolve import (
    find_aircraft,
    find_data,
    find_law,
    find_scenario,
    find_tune,
    library,
    list_aircraft,
    list_data,
    list_scenarios,
)
from testbed.scenario.schema import SCHEMA_VERSION, Scenario
from testbed.scenario.shorten import shorten

__all__ = [
    "SCHEMA_VERSION",
    "MiddleLoopGains",
    "Place",
    "Problem",
    "Scenario",
    "ScenarioError",
    "dump",
    "find_aircraft",
    "find_data",
    "find_law",
    "find_scenario",
    "find_tune",
    "json_schema",
    "library",
    "list_aircraft",
    "list_data",
    "list_scenarios",
    "load",
    "load_guidance",
    "load_middle_loop",
    "loads",
    "shorten",
]
