"""From the text of a page to an immutable `Scenario`; what is wrong is named by line and column."""

from testbed.scenario.editor import json_schema
from testbed.scenario.gains import MiddleLoopGains
from testbed.scenario.load import (
    Draft,
    dump,
    dump_middle_loop,
    gains_of,
    load,
    load_guidance,
    load_middle_loop,
    loads,
    open_draft,
)
from testbed.scenario.messages import Place, Problem, ScenarioError
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
from testbed.scenario.schema import SCHEMA_VERSION, Scenario
from testbed.scenario.shorten import shorten

__all__ = [
    "SCHEMA_VERSION",
    "Draft",
    "MiddleLoopGains",
    "Place",
    "Problem",
    "Scenario",
    "ScenarioError",
    "dump",
    "dump_middle_loop",
    "gains_of",
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
    "open_draft",
    "shorten",
]
