"""Aircraft that cannot be translated, compiled, proved or placed are flown by JSBSim."""

import re
import shutil

import pytest
from cases import ALL

import testbed
from testbed.cli.new import describe_engine
from testbed.compiled import CompiledAircraft, compiled_fleet, translate
from testbed.compiled.compiled_fleet import find_engine, find_engines, untranslated
from testbed.compiled.proof import Proof
from testbed.core.errors import InputError
from testbed.linear.steady_flight import build_compiled, steady_scenario
from testbed.plan.world import build
from testbed.scenario import library, load_scenario, loads, set_duration
from testbed.vehicle.jsbsim_adapter import load

RATE_HZ = 200
ALPHA = "<property> aero/alpha-rad </property>"
NUMBER = "<v>1</v>"


def table(rows):
    lines = "\n".join(f"{k} {k % 7}" for k in range(rows))
    head = "<independentVar>aero/alpha-rad</independentVar>"
    return f"<table>{head}<tableData>\n{lines}\n</tableData></table>"


def pairs(count):
    parts = "".join(f"<v>{k}</v><v>{k * k}</v>" for k in range(count))
    return f"<interpolate1d>{ALPHA}{parts}</interpolate1d>"


def make(folder, functions=(), components=""):
    """Copy a Rascal, with functions outside of axes and with components."""
    made = folder / "kite"
    shutil.copytree(library() / "aircraft" / "rascal110", made)
    file = (made / "rascal110.xml").rename(made / "kite.xml")
    text = "".join(f'<function name="made/f{k}">{t}</function>' for k, t in enumerate(functions))
    system = f'<system name="made"><channel name="made">{components}</channel></system>'
    file.write_text(
        file.read_text(encoding="utf-8")
        .replace("</flight_control>", f"</flight_control>{system if components else ''}")
        .replace('<axis name="DRAG">', f'{text}<axis name="DRAG">'),
        encoding="utf-8",
    )
    return made


def fly(kite, engine="auto", duration_s=0.2):
    text = f"extends: simulation-1\nscenario: {{engine: {engine}}}\nleader: {{aircraft: {kite}}}\n"
    return testbed.run(set_duration(loads(text), duration_s), write=False)


LIMITED = {
    # components that are at a limit in each state of the proof, and at the start only
    "in the proof": '<integrator name="made/it"><input>fcs/throttle-cmd-norm</input><c1>0.5</c1>'
    "<clipto><min>-2</min><max>2</max></clipto></integrator>"
    '<lag_filter name="made/lag"><input>aero/alpha-rad</input><c1>-240</c1></lag_filter>',
    "at the start": '<lag_filter name="made/lag"><input>velocities/vt-fps</input><c1>10</c1>'
    "<clipto><min>0</min><max>69</max></clipto></lag_filter>",
}


def odd_and_large(statements):
    """Functions with a table of one row, and lists and tables beyond the 200 that Python can nest.

    In test_engine_powers.py they are compiled and flown.

    Args:
        statements: number of elements of the lists that are a statement each, or two.
    """
    return [
        table(1),
        table(1_000),
        pairs(1_000),
        f"<switch><abs>{ALPHA}</abs>{NUMBER * 210}</switch>",
        f"<switch><abs>{ALPHA}</abs>{ALPHA * statements}</switch>",
        f"<sum>{ALPHA}{NUMBER * 210}</sum>",
        f"<min>{ALPHA}{NUMBER * statements}</min>",
        f"<and>{f'<lt>{ALPHA}{NUMBER}</lt>' * (statements // 2)}</and>",
    ]


def test_long_elements_are_translated(tmp_path):
    """Their source is parsed; short ones are compiled in test_compiled_literals.py."""
    long = make(tmp_path, odd_and_large(210))
    source = CompiledAircraft(long, load(long, RATE_HZ)).source
    assert min(source.count("least("), source.count("chosen(")) >= 210
    compile(source, "source", "exec")
    assert len(source) < 100_000


TOO_LARGE = {
    "sum": ([f"<sum>{NUMBER * 5_000}</sum>"], "", "has 5,000 elements"),
    "table": ([table(30_000)], "", "makes more than 50,000 numbers in tables"),
    "pairs": ([pairs(70).replace("<v>0</v>", ALPHA, 2)], "", "breakpoints that are not numbers"),
    "components": (
        [],
        "".join(
            f'<pure_gain name="made/c{k}"><input>aero/alpha-rad</input><gain>2</gain></pure_gain>'
            for k in range(200)
        ),
        "lines of source",
    ),
}


@pytest.mark.parametrize("name", TOO_LARGE)
def test_what_is_too_large_is_flown_by_jsbsim(tmp_path, monkeypatch, name):
    monkeypatch.setattr(translate, "MOST_LINES", 400)  # a fifth; a Rascal has fewer
    functions, components, words = TOO_LARGE[name]
    kite = make(tmp_path, functions, components)
    engine = find_engine(kite, RATE_HZ)
    assert engine.compiled is None
    (reason,) = engine.reasons
    assert re.match(rf"{kite}/kite.xml:\d+: <\w+> ", reason) and words in reason


def test_all_reasons_are_named_at_once(tmp_path):
    kite = make(
        tmp_path,
        ["<random/>", f"<product>{ALPHA}<p>simulation/sim-time-sec</p></product>"],
        '<pid name="made/pid"><input>aero/alpha-rad</input><kp>1</kp></pid>'
        '<pure_gain name="made/gain"><input>made/pid</input><gain>2</gain></pure_gain>'
        '<summer name="made/late"><input>aero/alpha-rad</input><delay>3</delay></summer>',
    )
    reasons = find_engine(kite, RATE_HZ).reasons
    found = [re.sub(r".*kite.xml:\d+: ", "", each) for each in reasons]
    assert found == [
        "<pid> is not translated",
        "<delay> is not translated",
        "<random> is not translated",
        "<p> reads simulation/sim-time-sec, which is not translated",
    ]
    compiled, reason = find_engines([kite, kite], RATE_HZ, "auto")
    assert not compiled and reason == f"{'; '.join(reasons)}; the aircraft is flown by JSBSim"
    with pytest.raises(InputError) as caught:
        find_engines([kite], RATE_HZ, "compiled")
    assert all(each in str(caught.value) for each in reasons)
    assert str(caught.value).endswith("(write engine: auto, and JSBSim flies the aircraft)")
    assert fly(kite).metrics["engine"] == "jsbsim"  # as the text has it


@pytest.mark.parametrize("where", LIMITED)
def test_components_at_a_limit_are_flown_by_jsbsim(tmp_path, monkeypatch, where):
    """The proof places before it runs, and so does a fleet: `make test` compiles nothing."""
    if where == "in the proof" or not ALL:
        monkeypatch.setattr(compiled_fleet, "prepare", lambda *_: None)
    if where == "at the start" and not ALL:
        monkeypatch.setattr(compiled_fleet, "prove_aircraft", lambda *_: Proof(1))
    kite = make(tmp_path, (), LIMITED[where])
    assert (find_engine(kite, RATE_HZ).compiled is None) == (where == "in the proof")
    run = fly(kite)
    assert (run.metrics["engine"], run.outcome) == ("jsbsim", "completed")
    with pytest.raises(InputError, match="engine: compiled: .*is placed at a limit.*engine: auto"):
        fly(kite, engine="compiled")


def fail(*_, **__):
    raise ZeroDivisionError("of a test")


@pytest.mark.parametrize("part", ["CompiledAircraft", "prepare", "prove_aircraft"])
def test_any_failure_is_a_reason(tmp_path, monkeypatch, part):
    kite = make(tmp_path, [f"<sin>{ALPHA}</sin>"])
    monkeypatch.setattr(compiled_fleet, "prepare", lambda *_: None)
    monkeypatch.setattr(compiled_fleet, part, fail)
    engine = find_engine(kite, RATE_HZ)
    assert engine.compiled is None
    assert "kite: cannot be " in engine.reasons[0]
    assert "(ZeroDivisionError: of a test)" in engine.reasons[0]


def test_lack_of_memory_is_no_reason(tmp_path, monkeypatch):
    kite = make(tmp_path, [f"<cos>{ALPHA}</cos>"])

    def exhaust(*_):
        raise MemoryError

    monkeypatch.setattr(compiled_fleet, "prepare", exhaust)
    with pytest.raises(MemoryError):
        find_engine(kite, RATE_HZ)


def test_error_of_a_progress_function_is_no_reason(tmp_path):
    kite = make(tmp_path, [f"<tan>{ALPHA}</tan>", f"<v>{hash(str(tmp_path)) % 10**9}</v>"])

    def show(*_):
        raise LookupError("of the user")

    text = f"extends: simulation-1\nleader: {{aircraft: {kite}}}\n"
    with pytest.raises(LookupError, match="of the user"):
        testbed.run(set_duration(loads(text), 0.2), write=False, progress=show)


def test_a_scenario_names_the_reasons_when_built(tmp_path):
    kite = make(tmp_path, ["<random/>"])
    text = f"extends: simulation-1\nscenario: {{engine: compiled}}\nleader: {{aircraft: {kite}}}\n"
    with pytest.raises(InputError, match="<random> is not translated"):
        build(loads(text))


def test_predictions_need_compiled_models(tmp_path):
    """Their engine is not the user's, which is "auto" already."""
    kite = make(tmp_path, ["<random/>"])
    scenario = load_scenario("simulation-1", [f"fleet.*.aircraft={kite}"])
    with pytest.raises(InputError) as caught:
        build_compiled(steady_scenario(scenario, 0.0, "compiled"))
    assert "<random> is not translated (predictions need compiled" in str(caught.value)
    assert "engine: auto" not in str(caught.value)


def test_new_aircraft_names_what_is_not_compiled(tmp_path):
    reasons = untranslated(make(tmp_path, ["<random/>"]), RATE_HZ)
    assert [re.sub(r".*kite.xml:\d+: ", "", each) for each in reasons] == [
        "<random> is not translated"
    ]
    assert describe_engine(reasons)[1:] == list(reasons)
    assert "JSBSim" in describe_engine(reasons)[0]
    assert untranslated(library() / "aircraft" / "rascal110", RATE_HZ) == ()
    assert describe_engine(())[0].startswith("engine: compiled, if it equals JSBSim")
