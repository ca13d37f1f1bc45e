"""Scenario files: read, check and resolve them to an immutable `Scenario`."""

from testbed.scenario.load import (
    ScenarioFile,
    dump,
    dump_middle_loop,
    load,
    load_guidance,
    load_middle_loop,
    loads,
    middle_loop_gains,
    open_scenario,
)
from testbed.scenario.middle_loop import MiddleLoopGains
from testbed.scenario.resolve import (
    find_aircraft,
    find_data,
    find_law,
    find_scenario,
    find_study,
    find_tune,
    find_tuning,
    library,
    list_aircraft,
    list_data,
    list_scenarios,
    list_studies,
    list_tunings,
)
from testbed.scenario.schema import SCHEMA_VERSION, Scenario, json_schema, set_duration
from testbed.scenario.violations import Place, Problem, ScenarioError

__all__ = [
    "SCHEMA_VERSION",
    "MiddleLoopGains",
    "Place",
    "Problem",
    "Scenario",
    "ScenarioError",
    "ScenarioFile",
    "dump",
    "dump_middle_loop",
    "find_aircraft",
    "find_data",
    "find_law",
    "find_scenario",
    "find_study",
    "find_tune",
    "find_tuning",
    "json_schema",
    "library",
    "list_aircraft",
    "list_data",
    "list_scenarios",
    "list_studies",
    "list_tunings",
    "load",
    "load_guidance",
    "load_middle_loop",
    "loads",
    "middle_loop_gains",
    "open_scenario",
    "set_duration",
]
