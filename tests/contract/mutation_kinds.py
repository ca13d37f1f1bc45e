"""What is mutated, and what the testbed does with each: give a result, or one clear error."""

import shutil
from pathlib import Path

import numpy as np

from testbed.scenario import dump, load, load_guidance, load_middle_loop, shorten
from testbed.state import Surfaces

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"
MOST_RUNS = 60  # of a study whose every page is read
ROWS = 40  # of a recording: what is wrong in a row is wrong in a thousand


class Kind:
    """One kind of input.

    Args:
        share: how many of a hundred mutations are of it.
        files: what may be mutated; paths below `home`, where all of them are put first.
        feed: gives the path of a mutated file to the testbed.
    """

    def __init__(self, share, put, feed):
        self.share, self.put, self.feed = share, put, feed


def copied(*sources, only):
    """Put files and folders below a home; the paths of those that may be mutated."""

    def put(home):
        for source in sources:
            ignore = shutil.ignore_patterns("data", "golden", "__pycache__")
            to = home / source.relative_to(ROOT)
            to.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, to, ignore=ignore, dirs_exist_ok=True)
            else:
                to.write_bytes(source.read_bytes())
            if to.suffix == ".csv":
                to.write_bytes(b"".join(to.open("rb").readlines()[:ROWS]))
        return sorted(p for p in home.rglob("*") if p.is_file() and only(p))

    return put


def ends(ending, *, within=""):
    return lambda path: path.suffix == ending and (not within or within in path.parent.parts)


def feed_page(path):
    """Read it, write it, build its world, and fly two steps."""
    from testbed.sim.loop import fly
    from testbed.sim.world import build

    page = load(path)
    dump(page)
    if "tests" in path.parts:
        return  # not for flying
    if page.scenario.duration_s > 2000 or len(page.aircraft) > 8 or page.rates.autopilot_hz > 500:
        return  # as good as any other, and as long as a flight
    page = shorten(page, 0.2)
    world = build(page)
    if world.partners:
        return  # they are not here
    fly(world, [], lambda now, due: False)


def feed_study(path):
    """Plan it, and read the page of one of its runs."""
    from testbed.study.checks import check
    from testbed.study.plan import load_study, plan

    runs = plan(load_study(path))
    if len(runs) <= MOST_RUNS:
        check(runs)
    else:
        runs[len(runs) - 1]


def feed_tune(path):
    from testbed.study.tune_page import load_tune

    load_tune(path)


def feed_pages_beside(path):
    """A study, a tune, or a page that one of them flies."""
    if "tunes" in path.parts:
        feed_tune(path)
    elif path.parent.name == "studies":
        feed_study(path)
    else:
        load(path)


def feed_param(path):
    from testbed.vehicle.params import read_params, stack

    gains = stack([read_params(path)], 1.0 / 50.0)
    assert np.isfinite(gains.each["p"]).all()


def feed_gains(path):
    folder = path.parent
    if path.name == "guidance.yaml":
        load_guidance(folder)
    else:
        load_middle_loop(folder, "paper")


def feed_table(path):
    """A recording as what its name says: a leader, a wind, a radio's trace, delays or commands."""
    from testbed.air.recorded import read_wind
    from testbed.guidance.replay import make_track, read_recording
    from testbed.network.channel import make_channel
    from testbed.network.trace import read_trace
    from testbed.vehicle.respond import read_commands

    if "leader" in path.name:
        make_track(read_recording(path), np.linspace(0.0, 0.3, 7))
    elif "wind" in path.name:
        read_wind(path, 10.0, 0.5)
    elif "trace" in path.name:
        read_trace(path, "lead", "uav1")
    elif "delays" in path.name:
        page = load(
            ROOT / "scenarios" / "simulation-3.yaml",
            [f"network.jitter={{distribution: empirical, file: {path}}}"],
        )
        make_channel(page.aircraft_names, page.network, 1)
    else:
        read_commands(path)


def feed_aircraft(path):
    """Load the aircraft, look at it, trim it, fly it."""
    from testbed.state import Origin
    from testbed.vehicle.fleet import JsbsimFleet
    from testbed.vehicle.jsbsim_door import airframe, linearize_aircraft
    from testbed.vehicle.start import Start
    from testbed.vehicle.trim import TrimPoint

    folder = path if path.suffix != ".xml" else path.parent
    if folder.name in ("Engines", "Systems"):
        folder = folder.parent
    airframe(folder)
    linearize_aircraft(folder, TrimPoint(airspeed=20.0))
    start = Start(position_ned=(0.0, 0.0, -100.0), course=0.0, airspeed=20.0)
    fleet = JsbsimFleet([folder], [start], Origin(), 200)
    for _ in range(5):
        fleet.step(Surfaces(*(np.full(1, each) for each in (0.1, 0.1, 0.1, 0.5))), 4)
        fleet.lost(fleet.read())
        fleet.air()
    assert fleet.rig is not None


def feed_log(path):
    """Read it back, show it, and finish it if it was cut."""
    from testbed.record.read import frames, read_log
    from testbed.sim.recover import recover

    log = read_log(path)
    repr(log)
    for _ in frames(log):
        pass
    recover(path)


def flown_log(home):
    """A run of a second, flown here."""
    import testbed

    page = shorten(load("simulation-3"), 1.0)
    testbed.run(page, out=home / "run")
    return [home / "run" / "run.mcap"]


AIRCRAFT = ROOT / "aircraft"
PAGES = (ROOT / "scenarios", DATA / "scenarios", AIRCRAFT)
KINDS = {
    "pages": Kind(
        14,
        copied(
            *PAGES,
            only=lambda p: (
                p.suffix == ".yaml" and "aircraft" not in p.parts and "studies" not in p.parts
            ),
        ),
        feed_page,
    ),
    "studies": Kind(14, copied(*PAGES, only=ends(".yaml", within="studies")), feed_pages_beside),
    "params": Kind(20, copied(*PAGES, AIRCRAFT, only=ends(".param")), feed_param),
    "gains": Kind(12, copied(AIRCRAFT, only=ends(".yaml")), feed_gains),
    "tables": Kind(
        20,
        copied(
            *(ROOT / "scenarios" / "data").glob("*.csv"),
            *(DATA / "scenarios").glob("*.csv"),
            *DATA.glob("*.csv"),
            only=ends(".csv"),
        ),
        feed_table,
    ),
    "aircraft": Kind(8, copied(AIRCRAFT, only=ends(".xml")), feed_aircraft),
    "logs": Kind(12, flown_log, feed_log),
}
