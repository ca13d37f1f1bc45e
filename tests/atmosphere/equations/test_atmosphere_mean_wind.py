"""The mean wind: its direction, its profile, how far it moves the air, and a recorded one."""

import re

import numpy as np
import pytest
from places import ROOT
from reference.adapters_atmosphere import mean_velocity, profile_factor

from testbed.atmosphere.mean_wind import (
    COLUMNS,
    LOGARITHMIC,
    POWER,
    Profile,
    make_mean_wind,
    read_wind,
    wind_from_direction,
)
from testbed.core.csv_table import read_table
from testbed.core.errors import InputError
from testbed.core.frames import FOOT

DATA = ROOT / "scenarios" / "data"
LOG_LAW, POWER_LAW = Profile(LOGARITHMIC, 10.0, 0.03), Profile(POWER, 10.0, 0.143)
STEADY = make_mean_wind(np.zeros(1), np.array([[3.0, -4.0, 0.5]]))


def wandering(profile=None, advection_height=0.0):
    """Rows at uneven times, with a vertical part."""
    rng = np.random.default_rng(50)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 3.0, 40))])
    velocity = rng.normal(0.0, 3.0, (41, 3))
    return make_mean_wind(time, velocity, profile=profile, advection_height=advection_height)


def test_wind_from_direction_blows_from_there():
    assert wind_from_direction(8.0, 0.0) == pytest.approx([-8.0, 0.0, 0.0])
    assert wind_from_direction(8.0, np.radians(90.0)) == pytest.approx([0.0, -8.0, 0.0], abs=1e-14)
    # from the south-west at 30° off west: 240° blows to 60°, cos 60° north and sin 60° east
    assert wind_from_direction(8.0, np.radians(240.0)) == pytest.approx([4.0, 6.9282032303, 0.0])
    directions = np.linspace(-np.pi, np.pi, 17)
    assert np.linalg.norm(wind_from_direction(8.0, directions), axis=-1) == pytest.approx(8.0)


def test_wind_from_direction_calm_has_no_minus_zero():
    assert not np.signbit(wind_from_direction(0.0, np.radians([0.0, 90.0, 250.0]))).any()


def test_log_profile_is_the_shear_of_the_standard():
    """MIL-F-8785C 3.7.3.2: W20 ln(h/z0)/ln(20/z0), z0 = 0.15 ft; by hand at 1000 ft."""
    shear = Profile(LOGARITHMIC, 20.0 * FOOT, 0.15 * FOOT)
    heights = FOOT * np.array([0.0, 0.1, 0.15, 20.0, 1000.0])
    # ln(1000/0.15) = 8.804875, ln(20/0.15) = 4.892852
    assert profile_factor(shear, heights) == pytest.approx([0.0, 0.0, 0.0, 1.0, 1.799538], abs=1e-6)


def test_log_profile_is_linear_in_log_height():
    parts = profile_factor(LOG_LAW, 10.0 * 2.0 ** np.arange(6.0))
    assert np.diff(parts) == pytest.approx(np.log(2.0) / np.log(10.0 / 0.03))


def test_power_profile_is_a_power_of_height():
    parts = profile_factor(POWER_LAW, 10.0 * 2.0 ** np.arange(-2.0, 4.0))
    assert parts[2] == 1.0
    assert parts[1:] / parts[:-1] == pytest.approx(2.0**0.143)
    assert profile_factor(POWER_LAW, np.array([0.0, -5.0])).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("shape", [(), (4,), (4, 6)])
def test_mean_wind_steady_uniform_is_constant(shape):
    """At all heights and times."""
    assert STEADY.steady and STEADY.uniform
    for time in (0.0, 12.3):
        found = mean_velocity(STEADY, time, np.full(shape, 70.0))
        assert found.shape == (*shape, 3)
        assert (found == [3.0, -4.0, 0.5]).all()


def test_profile_scales_the_horizontal_wind_only():
    wind = make_mean_wind(np.zeros(1), np.array([[3.0, -4.0, 0.5]]), profile=LOG_LAW)
    assert not wind.uniform
    heights = np.array([[0.01, 10.0], [50.0, 200.0]])
    found = mean_velocity(wind, 0.0, heights)
    assert found[..., 2] == pytest.approx(0.5)
    assert np.hypot(found[..., 0], found[..., 1]) == pytest.approx(
        5.0 * profile_factor(LOG_LAW, heights)
    )
    assert found[0, 1] == pytest.approx([3.0, -4.0, 0.5])


@pytest.mark.parametrize("profile", [None, LOG_LAW, POWER_LAW], ids=["uniform", "log", "power"])
def test_displacement_is_the_integrated_velocity(profile):
    """A second route: Gauss-Legendre, exact for what is linear, from row to row."""
    wind = wandering(profile, advection_height=80.0)
    assert not wind.steady
    time = wind.rows["time"]
    nodes, weights = np.polynomial.legendre.leggauss(2)
    for end in (0.0, 0.3, *time[[1, 7, 40]], 33.3):
        edges = np.array([*time[time < end], end])
        moved = np.zeros(3)
        for begin, stop in zip(edges[:-1], edges[1:], strict=True):
            at = 0.5 * (begin + stop) + 0.5 * (stop - begin) * nodes
            each = [wind.velocity_ned(t, 80.0) for t in at]
            moved += 0.5 * (stop - begin) * (weights @ np.array(each))
        assert wind.displacement_ned(end) == pytest.approx(moved, abs=1e-12)


def test_displacement_steady_is_proportional_to_time():
    assert STEADY.displacement_ned(20.0) == pytest.approx([60.0, -80.0, 10.0])
    sheared = make_mean_wind(
        np.zeros(1), np.array([[3.0, -4.0, 0.0]]), profile=LOG_LAW, advection_height=100.0
    )
    assert sheared.displacement_ned(20.0) == pytest.approx(20.0 * sheared.velocity_ned(0.0, 100.0))


def test_mean_wind_is_linear_between_its_rows():
    wind = wandering()
    for row, time in enumerate(wind.rows["time"]):
        assert wind.velocity_ned(time, 0.0) == pytest.approx(wind.rows["velocity"][row])
    middle = wind.rows["time"][4:6].mean()
    mean = wind.rows["velocity"][4:6].mean(axis=0)
    assert wind.velocity_ned(middle, 0.0) == pytest.approx(mean)


def write(tmp_path, text):
    path = tmp_path / "wind.csv"
    path.write_text(text)
    return path


def test_read_wind_first_row_is_time_0(tmp_path):
    path = write(tmp_path, "t_s,east_mps,north_mps,down_mps,note\n5,2,1,-1,a\n6.5,4,3,0,b\n")
    wind = read_wind(path, 10.0, 1.5)
    assert wind.time.tolist() == [0.0, 1.5]
    assert wind.velocity_ned.tolist() == [[1.0, 2.0, -1.0], [3.0, 4.0, 0.0]]


def test_read_wind_direction_is_interpolated_as_vector(tmp_path):
    path = write(tmp_path, "# a vane\nt_s, speed_mps, from_deg\n\n0, 4, 350\n10, 4, 10\n")
    wind = make_mean_wind(*read_wind(path, 10.0, 10.0))
    # the mean of two vectors 20° apart is 4 cos 10° long, and from north it blows south
    assert wind.velocity_ned(5.0, 0.0) == pytest.approx(
        [-4.0 * np.cos(np.radians(10.0)), 0.0, 0.0], abs=1e-14
    )


def test_read_wind_by_direction_equals_by_axes(tmp_path):
    rng = np.random.default_rng(51)
    speed, direction = rng.uniform(0.0, 9.0, 30), rng.uniform(0.0, 360.0, 30)
    north, east = -speed * np.cos(np.radians(direction)), -speed * np.sin(np.radians(direction))
    one = ["t_s,speed_mps,from_deg"]
    two = ["t_s,north_mps,east_mps"]
    for k in range(30):
        one.append(f"{k},{speed[k]},{direction[k]}")
        two.append(f"{k},{north[k]},{east[k]}")
    velocities = [
        read_wind(write(tmp_path, "\n".join(t)), 1.0, 29.0).velocity_ned for t in (one, two)
    ]
    assert velocities[0] == pytest.approx(velocities[1], abs=1e-13)


def test_gusty_wind_csv_is_as_its_origin_describes(tmp_path, monkeypatch):
    text = (DATA / "ORIGIN.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.S)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    columns = {name: COLUMNS[name] for name in ("t_s", "speed_mps", "from_deg")}
    ours, written = (
        read_table(path).numbers(columns)
        for path in (tmp_path / "gusty-wind.csv", DATA / "gusty-wind.csv")
    )
    # another machine's last bit may turn the last digit
    assert ours == pytest.approx(written, abs=0.0101)
    wind = read_wind(DATA / "gusty-wind.csv", 1.0, 600.0)
    assert np.linalg.norm(wind.velocity_ned, axis=1) == pytest.approx(written[:, 1])


HEAD = "t_s,north_mps,east_mps"
BROKEN = [
    ("", r"wind.csv:1: has no wind; add the columns north_mps, east_mps or speed_mps, from_deg$"),
    ("t_s,north_mps\n0,1\n1,1", r"wind.csv:1: missing column east_mps; add it to the header$"),
    ("t_s,from_deg\n0,1\n1,1", r"wind.csv:1: missing column speed_mps; add it"),
    ("north_mps,east_mps\n0,1\n1,1", r"wind.csv:1: missing column t_s; add it"),
    (
        "t_s,north_mps,east_mps,speed_mps\n0,1,1,1",
        r"wind.csv:1: has both north_mps, east_mps and speed_mps; keep north_mps, east_mps or ",
    ),
    (f"{HEAD}\n0,1,1", r"wind.csv: 1 rows of numbers; a recording needs at least two$"),
    (f"{HEAD}\n0,1,1\n1,x,1", r"wind.csv:3: north_mps is 'x'; write a number$"),
    # never the text of a file that is something else
    (
        f"{HEAD}\n0,1,1\n1,{'secret words ' * 9},1",
        r"wind.csv:3: north_mps is text; write a number$",
    ),
    (f"{HEAD}\n0,1,1\n1,inf,1", r"wind.csv:3: north_mps is inf; remove the row or write a finite"),
    (f"{HEAD}\n0,1,1\n1,,1", r"wind.csv:3: north_mps is empty; write a number or remove the row$"),
    (f"{HEAD}\n0,1,1\n1,1", r"wind.csv:3: 2 values under 3 columns; write one value per column$"),
    (f"{HEAD}\n0,1,1\n,,", r"wind.csv:3: t_s is empty"),
    (
        f"{HEAD}\n0,1,1\n# stuck\n0,1,1",
        r"wind.csv:4: t_s goes from 0 to 0 after line 2: t_s does not increase; sort the rows",
    ),
    (
        f"{HEAD}\n0,1,1\n# lost\n5.25,1,1",
        r"wind.csv:4: t_s goes from 0 to 5.25 after line 2: a gap of more than 5 s before this "
        r"row; fill in the missing rows, or raise air.wind.max_gap_s$",
    ),
    (
        f"{HEAD}\n1,1,1\n5,1,1",
        r"wind.csv: the recorded wind lasts 4.00 s, the scenario 5.00 s; set scenario.duration_s "
        r"to 4 or less, or record longer$",
    ),
    (
        "t_s,speed_mps,from_deg\n0,1,0\n5,-1,0",
        r"wind.csv:3: speed_mps is -1, and air.wind.speed_mps allows 0 to 60 m/s \(write m/s, or "
        r"remove the row\)$",
    ),
]


@pytest.mark.parametrize(("text", "words"), BROKEN, ids=[text[-20:] for text, _ in BROKEN])
def test_read_wind_invalid_file_error_names_line(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read_wind(write(tmp_path, text), 5.0, 5.0)


def test_read_wind_binary_or_missing_is_rejected(tmp_path):
    path = tmp_path / "wind.csv"
    path.write_bytes(b"t_s,\xff\n")
    with pytest.raises(InputError, match=r"wind.csv: line 1 is not UTF-8 text"):
        read_wind(path, 5.0, 5.0)
    with pytest.raises(InputError, match=r"gone.csv: cannot be read: No such file"):
        read_wind(tmp_path / "gone.csv", 5.0, 5.0)


def test_read_wind_epoch_stamps_lose_no_row(tmp_path):
    """Seconds since 1970 have an error of some 1e-7 s, so 9.9 s of them are at times 9.8999999."""
    lengths = []
    for millisecond in range(0, 100, 7):
        rows = [f"{1_700_000_000 + (900 * k + millisecond) / 1000:.3f},1,1" for k in range(12)]
        wind = read_wind(write(tmp_path, "\n".join([HEAD, *rows])), 1.0, 9.9)
        lengths.append(wind.time[-1])
    assert min(lengths) < 9.9 < max(lengths)
    assert lengths == pytest.approx([9.9] * len(lengths), abs=1e-6)
    with pytest.raises(InputError, match=r"lasts 9.90 s, the scenario 9.91 s"):
        read_wind(tmp_path / "wind.csv", 1.0, 9.91)
