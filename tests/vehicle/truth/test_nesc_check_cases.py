"""JSBSim as the product sets it, against the tools of NASA's check cases."""

import shutil

import pytest
from nesc_cases import CASES, DATA, PITCH, ROLL_RATE, YAW, fly, tools

from testbed.vehicle.environment import JSBSIM_DEFAULT_INTEGRATORS

each_rate = pytest.mark.parametrize("rate_hz", [100, 200])
MOON = """
  <planet name="Moon">
    <equatorial_radius unit="FT"> 5702559.05 </equatorial_radius>
    <polar_radius unit="FT"> 5695439.63 </polar_radius>
    <rotation_rate unit="RAD/SEC"> 0.0000026617 </rotation_rate>
    <GM unit="FT3/SEC2"> 1.7314079E14 </GM>
    <J2> 2.033542482111609E-4 </J2>
  </planet>
"""


def outside(differences):
    """Quantities with a value that is farther from the median than the tools are apart."""
    return {each.quantity for each in differences if each.outside}


@each_rate
@pytest.mark.parametrize("number", CASES)
def test_nesc_case_is_inside_the_spread(number, rate_hz):
    flown = fly(number, rate_hz)
    assert len(flown) == len(tools(number)) >= 7 * 9
    assert not [each for each in flown if each.outside]


@each_rate
def test_nesc_brick_by_euler_is_outside(rate_hz):
    assert outside(fly(2, rate_hz, JSBSIM_DEFAULT_INTEGRATORS)) >= {YAW, PITCH, ROLL_RATE}


@pytest.mark.parametrize(
    ("number", "changes", "quantity"),
    [
        pytest.param(10, {"simulation/gravity-model": 0}, "altitudeMsl_ft", id="without J2"),
        pytest.param(6, {"atmosphere/delta-T": 0.5}, "speedOfSound_ft_s", id="warmer air"),
    ],
)
def test_nesc_other_environment_is_outside(number, changes, quantity):
    assert quantity in outside(fly(number, 100, changes=changes))


@pytest.mark.parametrize("number", [7, 8])
def test_nesc_case_without_wind_is_outside(monkeypatch, number):
    monkeypatch.setitem(CASES, number, CASES[number]._replace(wind_fps=None))
    assert "feVelocity_ft_s_Y" in outside(fly(number, 100))


def test_planet_of_an_aircraft_is_replaced_by_earth(tmp_path):
    sphere = shutil.copytree(DATA / "sphere", tmp_path / "sphere") / "sphere.xml"
    text = sphere.read_text(encoding="utf-8")
    sphere.write_text(text.replace("\n  <metrics>", f"{MOON}  <metrics>"), encoding="utf-8")
    assert "Moon" in sphere.read_text(encoding="utf-8")
    assert fly(1, 100, folder=tmp_path) == fly(1, 100)
