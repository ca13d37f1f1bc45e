"""Lack of memory ends a command with one line; it is no loss, damage or fault of an input."""

import errno
from concurrent.futures import Future
from types import SimpleNamespace

import golden_scenarios as samples
import pytest
from commands import call_command
from small_study import in_this_process

import testbed
from testbed.airframes.airframe_validation import probe_in_copy
from testbed.airframes.forked_trial import run_forked
from testbed.cli import check
from testbed.core.errors import InputError, memory_shortage
from testbed.logs import arrow_io, mcap_file
from testbed.plan.user_code import _pickled
from testbed.pool.flight_pool import FlightPool
from testbed.pool.flight_task import FlightTask, run_task
from testbed.pool.local_workers import LocalWorkers
from testbed.scenario import find_aircraft, load_scenario, set_duration, with_values
from testbed.views.view import RerunView

SHORT = set_duration(load_scenario("simulation-3", ["fleet.uav1.commanded_by=external"]), 1)
LAW = """
class Greedy:
    def __init__(self, formation):
        pass

    def start(self, own):
        return ()

    def step(self, now, own, inbox, memory):
        raise MemoryError
"""


def greedy(*arguments, **named):
    raise MemoryError


class Greedy:
    """An object that no memory holds."""

    __reduce_ex__ = greedy


def greedy_system(*arguments, **named):
    raise OSError(errno.ENOMEM, "Cannot allocate memory")


def test_flight_model_without_memory_is_no_loss():
    with testbed.Simulation(with_values(SHORT, [(("scenario", "engine"), "jsbsim")])) as simulation:
        simulation._world.fleet._runs[1] = greedy
        with pytest.raises(MemoryError):
            simulation.step()
        assert not simulation.state.lost.any()


@pytest.mark.parametrize("work", [greedy, greedy_system])
def test_airframe_is_not_refused_for_lack_of_memory(work):
    with pytest.raises(MemoryError) as caught:
        probe_in_copy(find_aircraft("rascal110"), work)()
    assert "not enough memory: " in memory_shortage(caught.value)
    assert run_forked(lambda _: 1 / 0)().error == "division by zero"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log") / "run"
    testbed.run(SHORT, out=folder)
    return folder / "run.mcap"


@pytest.mark.parametrize("read", [mcap_file.read, mcap_file.read_attachments, testbed.load_run])
def test_log_is_not_damaged_for_lack_of_memory(read, log, monkeypatch):
    read(log)
    monkeypatch.setattr(mcap_file, "_records", greedy)
    monkeypatch.setattr(mcap_file.records.Attachment, "read", greedy)
    with pytest.raises(MemoryError):
        read(log)


def test_table_is_parquet_without_memory(tmp_path, monkeypatch):
    """The size of a page in a damaged file may ask for more than any machine has."""
    path = tmp_path / "table.parquet"
    path.write_bytes(b"")
    monkeypatch.setattr(arrow_io.parquet, "ParquetFile", greedy)
    with pytest.raises(InputError, match=r"table\.parquet: not enough memory to read it: an "):
        arrow_io.column_names(path)


def test_law_without_memory_has_its_line(tmp_path):
    (tmp_path / "greedy.py").write_text(LAW)
    (tmp_path / "case.yaml").write_text(
        "extends: simulation-3\nscenario: {name: case}\ncontroller: {law: 'greedy:Greedy'}\n"
    )
    arguments = ("run", "case.yaml", "--duration=1", "--quiet", "--out=run")
    error = call_command(*arguments, cwd=tmp_path, code=2, columns=500).stderr
    assert error.startswith("error: not enough memory: ") and error.count("\n") == 1
    assert "greedy.py:10: " in error


def test_memory_of_a_law_is_compared_or_an_error():
    with pytest.raises(MemoryError):
        _pickled(Greedy())
    assert _pickled(lambda: 1) == b""


@pytest.mark.parametrize("name", ["run", "Batch"])
def test_flight_without_memory_is_no_result_of_a_study(name, monkeypatch):
    monkeypatch.setattr(f"testbed.runs.repeated.{name}", greedy)
    scenario = SHORT if name == "run" else set_duration(load_scenario("simulation-3"), 1)
    with pytest.raises(MemoryError):
        run_task(FlightTask(0, scenario))
    future = Future()
    future.set_exception(MemoryError())
    pool = FlightPool(SimpleNamespace(lost_worker=lambda error: False), None)
    with pytest.raises(MemoryError):
        pool._result(future, FlightTask(0, SHORT))


def test_check_without_memory_is_one_error_line(tmp_path, monkeypatch):
    samples.write(tmp_path, "exact")
    options = ("--update", "--seeds", "3", "--reason", "first flights")
    with in_this_process():
        call_command("check", "exact.yaml", *options, cwd=tmp_path, code=0, columns=100)
    before = samples.files(tmp_path)

    def submit(pool, task):
        pool._free.pop()
        future = Future()
        future.set_exception(MemoryError())
        return future

    monkeypatch.setattr(LocalWorkers, "submit", submit)
    done = call_command("check", "exact.yaml", "--jobs=1", cwd=tmp_path, code=2, columns=100)
    assert done.stderr.endswith(
        "error: not enough memory: an allocation failed (end other programs, or raise the limits, "
        "ulimit -v and -u)\n"
    )
    assert "failed" not in done.stdout and samples.files(tmp_path) == before


def test_report_of_check_without_memory_ends_it(tmp_path, monkeypatch):
    case = SimpleNamespace(source=tmp_path / "case.yaml", scenario=SHORT)
    monkeypatch.setattr("testbed.golden.golden_report.failing_seeds", lambda verdict: [1])
    monkeypatch.setattr("testbed.runs.run.run", greedy)
    with pytest.raises(MemoryError):
        check._write_reports([case], [SimpleNamespace(passed=False, name="x")], tmp_path, None)


@pytest.mark.parametrize(
    ("error", "text"),
    [(MemoryError(), "not enough memory: "), (ValueError(), "ValueError"), (OSError("x"), "x")],
)
def test_warning_of_a_view_has_a_text(error, text, caplog):
    """Also of errors that have none; a view does not end a flight."""

    def send(batch):
        raise error

    view = RerunView(SimpleNamespace(open=lambda scene: None))
    view._sink = SimpleNamespace(send=send)
    view._collector = SimpleNamespace(take=lambda: None)
    view._send()
    (record,) = caplog.records
    assert record.getMessage().startswith(f"The view stops here, the run goes on: {text}")
