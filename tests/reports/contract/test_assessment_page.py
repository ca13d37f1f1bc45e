"""The page of an assessment: what is short is marked, and nothing of a file is HTML."""

import re

from testbed.reports.assessment_page import assessment_page, row_lines
from testbed.reports.html import render_page

FOLLOWER = {
    "name": "uav1",
    "bank_deg": 0.0,
    "damping": 0.3,
    "frequency_hz": 1.0,
    "factor": 2.5,
    "factor_of": "pitch",
    "phase_deg": 50.0,
    "phase_of": "roll",
    "latency_s": 0.2,
}
FLIGHT = {"failed": "uav1", "problem": "", "separation_m": 5.0, "between": ["leader", "uav1"]}


def document(**rows):
    return {
        "scenario": "a <b>",
        "question": "<script>",
        "verdict": "no-go",
        "flown": ["10 s"],
        "flights": 59,
        "first_seed": 1,
        "criteria": ["completed"],
        "short": [{"row": "margins", "text": "expect.rms_m.late.max: uav1: 3 m, above 2 m"}],
        "least_margins": {"factor": 2.0, "phase_deg": 30.0, "damping": 0.0},
        "energy": [],
        "parameters": [],
        "compared": [],
        "not_said": ["the weather"],
        "code": "testbed",
        "command": "testbed assess",
        "cpu_s": 1.0,
        "rows": rows,
    }


def margins(**changes):
    case = {"bank_deg": 45.0, "climb_mps": 0.0, "followers": [{**FOLLOWER, **changes}]}
    return {"cases": [case], "command": ""}


def marked(**rows):
    page = render_page(assessment_page(document(**rows)))
    return re.findall(r'<td class="red bold"[^>]*>([^<]*)</td>', page)


def test_short_margins_are_marked():
    assert marked(margins=margins()) == []
    assert marked(margins=margins(damping=-0.003)) == ["-0.003"]
    assert marked(margins=margins(damping=None, factor=None, phase_deg=None)) == []
    assert marked(margins=margins(factor=1.9)) == ["1.90 on pitch"]
    assert marked(margins=margins(phase_deg=29.0)) == ["29° on roll"]
    problem = {"cases": [{"bank_deg": 45.0, "climb_mps": 0.0, "problem": "not steady"}]}
    assert marked(margins=problem) == ["not predicted: not steady"]


def condition(value):
    weakest = {"seed": 5, "value": 0.6, "why": "expect.rms_m.max: uav1: 3 m", "command": "run it"}
    numbers = {"value": value, "largest_tried": False, "breaks": 0.7, "others": [0.4, 0.6]}
    more = {"seeds": 59, "flights": 80, "flown_with": "", "command": "assess it"}
    return {**numbers, **more, "weakest": weakest}


def test_a_condition_without_a_value_is_marked():
    assert marked(loss=condition(0.5)) == []
    assert marked(loss=condition(None)) == ["no value"]
    page = render_page(assessment_page(document(loss=condition(0.5))))
    assert "seed 5 at 60 %: rms_m: uav1: 3 m" in page
    assert "run it" in page and "assess it" in page
    assert list(row_lines(document(loss=condition(0.5)))) == [
        "lost messages               50 %, other seeds 40 to 60, median flight breaks at 70 %"
    ]


def test_lost_aircraft_are_marked_and_named_above():
    flight = {**FLIGHT, "does": {"leader": "flies on", "uav1": "lost at 9 s"}, "command": "fly it"}
    harmless = {"at_s": 5.0, "flights": [{**flight, "what": ""}]}
    harmful = {"at_s": 5.0, "flights": [{**flight, "what": "lost: leader"}]}
    assert marked(**{"engine-out": harmless}) == ["lost at 9 s", ""]
    page = render_page(assessment_page(document(**{"engine-out": harmful})))
    assert "engine out of uav1; <a" in page
    assert "<script>" not in page and "a &lt;b&gt;" in page
