"""Public objects and all errors are copied, pickled and sent through a process, or say why not.

Both are found by a walk over the modules: a new public class needs a line in `make_objects`, a new
error nothing.
"""

import copy
import importlib
import inspect
import multiprocessing
import pickle
import pkgutil
import types
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from slow_control import RATES

import testbed
import testbed.law
import testbed.rl
from testbed.core.errors import InputError, NotCopied, NotCopiedError, Portable
from testbed.scenario import load_scenario, set_duration
from testbed.scenario.problems import FilePosition, Problem

SHORT = set_duration(load_scenario("simulation-3"), 1.0)
PROBLEMS = [Problem(FilePosition("a.yaml", k, 2), f"is {k}", ("a", "b")) for k in range(30)]
# What the parameters of an error's constructor are given, by their annotations.
SAMPLES = {
    "Path": Path("a/b.xml"),
    "<class 'float'>": 0.5,
    "str": "network.loss: is 2 (write a number from 0 to 1)",
    "int": 3,
    "float": 0.5,
    "bool": False,
    "Sequence[Problem]": PROBLEMS,
}


def modules():
    """All modules of the package that can be imported here."""
    for each in pkgutil.walk_packages(testbed.__path__, "testbed."):
        if each.name not in ("testbed.__main__", "testbed.views.feeder_process", "testbed.trials"):
            yield importlib.import_module(each.name)


def error_classes():
    """All exceptions that a module defines."""
    found = set()
    for module in modules():
        for each in vars(module).values():
            if isinstance(each, type) and issubclass(each, Exception):
                if each.__module__.startswith("testbed."):
                    found.add(each)
    return sorted(found, key=lambda each: (each.__module__, each.__qualname__))


def make_error(kind):
    """An error of a class, with arguments that its constructor takes."""
    owner = next(each for each in kind.__mro__ if "__init__" in vars(each))
    if not owner.__module__.startswith("testbed."):
        return kind("some text\twith a tab")
    parameters = [*inspect.signature(kind.__init__).parameters.values()][1:]
    given = {}
    arguments = []
    for each in parameters:
        if each.kind in (each.VAR_POSITIONAL, each.VAR_KEYWORD):
            continue
        value = SAMPLES[str(each.annotation)]
        if each.kind is each.KEYWORD_ONLY:
            given[each.name] = value
        else:
            arguments.append(value)
    return kind(*(arguments or ["some text"]), **given)


def same(one, other):
    """Whether two objects have equal content."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray) and one.dtype.names:  # what is between fields is no number
        return one.dtype == other.dtype and all(same(one[n], other[n]) for n in one.dtype.names)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    if isinstance(one, BaseException):
        mine, theirs = vars(one), vars(other)
        return str(one) == str(other) and same(one.args, other.args) and same(mine, theirs)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, types.FunctionType):
        return one.__code__ == other.__code__
    if isinstance(one, partial):
        return same((one.func, one.args), (other.func, other.args))
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if one == other:
        return True
    return bool(vars(one)) and same(vars(one), vars(other))


def give_back(value):
    return value


def raise_on(error):
    raise error


def test_every_error_survives_a_process():
    """Text, arguments, attributes and notes, also as what a process has raised."""
    kinds = error_classes()
    assert len(kinds) > 25 and InputError in kinds
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        for kind in kinds:
            error = make_error(kind)
            error.add_note("in row 3")
            ways = [copy.copy(error), copy.deepcopy(error), pickle.loads(pickle.dumps(error))]
            ways.append(pool.submit(give_back, error).result(60))
            raised = pool.submit(raise_on, error).exception(60)
            raised.__cause__ = None
            ways.append(raised)
            for each in ways:
                assert same(error, each), (kind, str(error), str(each), vars(each))


def test_errors_with_own_constructors_are_portable():
    """And a class that is not fails the comparison."""

    class Plain(ValueError):
        def __init__(self, name, text):
            self.name = name
            super().__init__(text)

    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        copy.copy(Plain("a", "b"))
    for kind in error_classes():
        own = "__init__" in vars(kind)
        assert not own or issubclass(kind, Portable), kind


def test_scenario_error_is_the_same_through_a_pool():
    with pytest.raises(InputError) as caught:
        load_scenario("simulation-3", ["network.los=0.1"])
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        error = pool.submit(load_scenario, "simulation-3", ["network.los=0.1"]).exception(60)
    assert str(error) == str(caught.value) and error.problems == caught.value.problems
    assert "\n" not in str(error)


@testbed.kernel(memory=[("count", float)])
def steady(now, own, inbox, memory, config):
    return testbed.law.FbwaCommand(0.0, 0.0, 0.5)


def stage(now, records):
    pass


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_objects(tmp_path_factory.mktemp("copies"))


def make_objects(folder):
    """Objects of all public classes, and what public functions and methods return, by name."""
    run = testbed.run(SHORT, out=folder / "run")
    simulation = testbed.Simulation(SHORT)
    simulation.step(until=0.5)
    records = simulation.state.records
    batch = testbed.Batch(SHORT, seeds=[1, 2])
    batch.step(0.5)
    aircraft = testbed.Aircraft("rascal110", airspeed_mps=22, duration_s=4)
    hold = testbed.rl.HoldSlotEnv(duration_s=2.0)
    hold.reset(seed=1)
    n = np.zeros((3, 3))
    law = testbed.law
    scan = testbed.GainScan("hold-slot", RATES)  # of one follower
    return {
        "Aircraft": aircraft,
        "Batch": batch,
        "FlightData": run.data,
        "FlightRecords": testbed.FlightRecords(*(each.copy() for each in records)),
        "GainScan": scan,
        "LinearSystem": scan.formation(),
        "Run": run,
        "Simulation": simulation,
        "Tuning": testbed.Tuning("x8-middle-loop"),
        "UserStage": testbed.UserStage("mine", "fly by wire", stage),
        "FbwaCommand": law.FbwaCommand(*n),
        "Inbox": law.Inbox(*np.zeros((len(law.Inbox._fields), 3))),
        "OwnState": law.OwnState(*np.zeros((8, 3))),
        "Outputs": law.Outputs([("mode", int)], events={"mode": ["off", "on"]}),
        "FollowerHbh23": law.FollowerHbh23(*np.zeros((3, 1))),
        "UnicycleCommand": law.UnicycleCommand(*np.zeros((5, 3))),
        "VehicleState": law.VehicleState(*np.zeros((7, 3))),
        "LimiterFlag": law.LimiterFlag(1),
        "Saturation": law.Saturation(1),
        "FollowerConfig": law.FollowerConfig(*range(len(law.FollowerConfig._fields))),
        "FormationConfig": simulation._world.formation.built_control.config,
        "HoldSlotEnv": hold,
        "HoldSlotVectorEnv": testbed.rl.HoldSlotVectorEnv(1, starts=1, duration_s=2.0),
        "FormationVectorEnv": testbed.rl.FormationVectorEnv(1, starts=1, duration_s=2.0),
        "FormationEnv": None,
        "kernel": steady,
        "scenario": SHORT,
        "saved": simulation.save(),
        "sample": simulation.state,
        "metrics": simulation.metrics,
        "events": run.data.events,
    }


def public_classes():
    for module in (testbed, testbed.law, testbed.rl):
        names = getattr(module, "__all__", None) or [n for n in dir(module) if n[0].isupper()]
        for name in names:
            each = getattr(module, name)
            if isinstance(each, type) and not issubclass(each, BaseException):
                yield name, each


def test_every_public_class_has_an_object_here(made):
    missing = {
        name
        for name, kind in public_classes()
        if name not in made and not getattr(kind, "_is_protocol", False)
    }
    assert missing == set()
    for name, kind in public_classes():
        if made.get(name) is not None:
            assert isinstance(made[name], kind)


def test_public_objects_are_copied_or_refused(made):
    """A refusal is a TypeError, as `copy` and `pickle` raise it, with a sentence."""
    refused = set()
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        ways = {
            "copy": copy.copy,
            "deepcopy": copy.deepcopy,
            "pickle": lambda each: pickle.loads(pickle.dumps(each)),
            "process": lambda each: pool.submit(give_back, each).result(60),
        }
        for name, each in made.items():
            for way, function in ways.items() if each is not None else ():
                try:
                    found = function(each)
                except NotCopiedError as error:
                    assert "cannot be copied" in str(error) and "(" in str(error), (name, way)
                    refused.add(name)
                else:
                    assert same(each, found), (name, way)
    assert {"Simulation", "Batch", "Aircraft", "saved"} <= refused
    assert not refused & {"Run", "FlightData", "LinearSystem", "scenario", "metrics"}


def test_refusals_of_copies_have_sentences():
    for kind in (each for module in modules() for each in vars(module).values()):
        if isinstance(kind, type) and issubclass(kind, NotCopied) and kind is not NotCopied:
            own = any("_why_not_copied" in vars(each) for each in kind.__mro__ if each != NotCopied)
            assert own, kind
