"""Functions and components with the literals of real files, compiled and in JSBSim.

The files are those of JSBSim's collection of aircraft. Each function of the translator's table, and
each component, is evaluated with every literal that they have in its place.
"""

import hashlib
import re
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from compiled_elements import grid, make, value

from testbed.compiled.components import component, component_name
from testbed.compiled.elements import NotTranslated, read_aircraft
from testbed.compiled.functions import expression
from testbed.compiled.source import StepSource
from testbed.compiled.translate import _HEADER
from testbed.core.compile import entry_of_source
from testbed.vehicle.jsbsim_adapter import SHARED_FILES, load

MANY = 8  # elements, of which LINE_PARTS are added in one line in place of the translator's 50
LINE_PARTS = 5
DT = 1e-12  # s, of a frame: the aircraft stays where it is, and filters have the step of loading
INPUTS = ("made/x", "made/y", "made/z")
X, Y, Z = (f"<property> {name} </property>" for name in INPUTS)
SPECIAL = (
    *(np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.0, 2.0, 0.5, 5e-324, -5e-324, 1e-310, 2.2e-308),
    *(1.7e308, -1.7e308, 0.1, 0.3, -0.2, 0.7, -0.5, 1.5, 2.5, -2.5, 1e16),
)
# Exponents and bases that LLVM replaces, beside those of the files.
KNOWN = {
    ("pow", 1): (2.0, 0.5, -1.0, 0.25, 1 / 3, 1.5, 3.0, -2.0),
    ("pow", 0): (2.0, 4.0, 0.5, 10.0),
}
# JSBSim ends a flight where their arguments are out of range.
_SAFE = {
    "not": f"<not><gt>{X}{Y}</gt></not>",
    "and": f"<and><lt>{X}{Y}</lt><gt>{X}{Z}</gt></and>",
    "or": f"<or><lt>{X}{Y}</lt><gt>{X}{Z}</gt></or>",
    "ifthen": f"<ifthen><lt>{X}{Y}</lt><sin>{X}</sin><pow>{Y}{value(2)}</pow></ifthen>",
}


def _when(test, text):
    """Evaluate a function where JSBSim does."""
    return f"<ifthen>{test}{text}{value(0)}</ifthen>"


IN_10, IN_100 = (
    f"<and><gt>{X}{value(0)}</gt><lt>{X}{value(count - 1)}</lt></and>" for count in (10, 100)
)
FINITE = f"<and><lt><abs>{X}</abs>{value(1e300)}</lt><lt><abs>{Y}</abs>{value(1e300)}</lt></and>"
WHOLE = f"<and><lt><abs>{X}</abs>{value(2e9)}</lt><gt><abs>{Y}</abs>{value(1)}</gt></and>"
ROWS = """<independentVar lookup="row"> made/x </independentVar>
<independentVar lookup="column"> made/y </independentVar>"""


def table_1(rows):
    lines = "\n".join(f"{0.01 * k * k - 0.5} {np.sin(k)}" for k in range(rows))
    head = "<independentVar> made/x </independentVar>"
    return f"<table>{head}<tableData>\n{lines}\n</tableData></table>"


def pairs(count):
    parts = (f"{value(0.3 * k - 0.6)}{value(np.cos(k))}" for k in range(count))
    return f"<interpolate1d>{X}{''.join(parts)}</interpolate1d>"


PART = f"<fraction><abs>{X}</abs></fraction>"  # 0 to 1
OWN = {
    **_SAFE,
    "not-part": _when(FINITE, f"<not>{PART}</not>"),
    "and-part": _when(FINITE, f"<and>{PART}<lt>{X}{Y}</lt></and>"),
    "or-part": _when(FINITE, f"<or>{PART}<lt>{X}{Y}</lt></or>"),
    "ifthen-part": _when(FINITE, f"<ifthen>{PART}{X}{Y}</ifthen>"),
    **{f"table-{rows}": table_1(rows) for rows in (1, 2, 9, 70)},
    "table-2d": f"<table>{ROWS}{grid(1.0)}</table>",
    "table-3d": f'<table>{ROWS}<independentVar lookup="table"> made/z </independentVar>'
    + "".join(grid(k, f' breakPoint="{at}"') for k, at in ((1.0, -1.0), (1.7, 0.2), (0.3, 1.5)))
    + "</table>",
    **{f"interpolate1d-{count}": pairs(count) for count in (2, 7, 70)},
    **{
        f"switch-{count}": _when(IN_100, f"<switch>{X}{''.join(map(value, range(count)))}</switch>")
        for count in (100,)
    },
    "switch-read": _when(IN_10, f"<switch>{X}{Y}{Z}{value(1) * 8}</switch>"),
    "min-many": f"<min>{X}{Y * MANY}{Z}</min>",
    "and-many": f"<and>{f'<lt>{X}{Y}</lt>' * MANY}<lt>{X}{Z}</lt></and>",
    "mod": _when(WHOLE, f"<mod>{X}{Y}</mod>"),
    "sum-many": f"<sum>{X}{Y * MANY}{Z}{value(0.1) * MANY}</sum>",
    "difference-many": f"<difference>{X}{Y * MANY}{Z}{value(0.1) * MANY}</difference>",
    "avg-many": f"<avg>{X}{Y * MANY}{Z}</avg>",
    "power of a sine": f"<pow><sin>{X}</sin>{value(2)}</pow>",
    "power of a choice": f"<pow>{X}<ifthen><lt>{Y}{Z}</lt>{value(2)}{value(0.5)}</ifthen></pow>",
    "power of a constant": f"<pow>{X}<product>{value(4)}{value(0.5)}</product></pow>",
    "sine and cosine": f"<product><sin>{X}</sin><cos>{X}</cos></product>",
    "negative sine": f"<sin><product>{value(-1)}{X}</product></sin>",
    "one-argument round": f"<roundmultiple>{X}</roundmultiple>",
}
ONE = (
    "sqrt exp sin cos tan asin acos atan abs log10 ln log2 integer floor ceil toradians todegrees "
    "sign fraction"
)
TWO = "pow atan2 fmod sum product difference lt le gt ge eq nq min max avg quotient roundmultiple"
GUARDED = {"roundmultiple": FINITE}


@cache
def literals():
    """Collect the literals of functions in the collection, by element and position."""
    found = {at: set(values) for at, values in KNOWN.items()}
    for root in _roots():
        for node in root.iter():
            for k, child in enumerate(node):
                if child.tag in ("value", "v") and child.text:
                    found.setdefault((node.tag, min(k, 1)), set()).add(float(child.text))
    return {at: sorted(values) for at, values in sorted(found.items())}


def functions():
    """Return the text of each function, by name."""
    made = dict(OWN)
    for tag in ONE.split():
        made[tag] = f"<{tag}>{X}</{tag}>"
    for tag in TWO.split():
        made[tag] = f"<{tag}>{X}{Y}</{tag}>"
    for (tag, place), values in literals().items():
        for each in values if tag in TWO.split() else ():
            parts = (value(repr(each)), X) if place == 0 else (X, value(repr(each)))
            made[f"{tag} {each!r} at {place}"] = f"<{tag}>{parts[0]}{parts[1]}</{tag}>"
    return {
        name: _when(GUARDED[tag], text) if (tag := name.split()[0]) in GUARDED else text
        for name, text in made.items()
    }


_KINDS = "pure_gain deadband aerosurface_scale scheduled_gain summer kinematic actuator"
FILTERS = "lag_filter lead_lag_filter second_order_filter washout_filter integrator"
_NUMBERS = re.compile(r"[-+\d.eE\s]*")


@cache
def components():
    """Return the text of each different component of the collection, with the input made/x."""
    made = [_named(name.split("-")[0], text) for name, text in OWN_COMPONENTS.items()]
    for root in _roots():
        for node in root.iter():
            if node.tag in f"{_KINDS} {FILTERS}".split() and (text := _component(node)):
                made.append(_named(node.tag, text))
    return list(dict.fromkeys(made))


def _named(tag, text):
    return f"<{tag} name='#'>{text}</{tag}>"


_INPUT = "<input> made/x </input>"
OWN_COMPONENTS = {
    "actuator-falling": f'{_INPUT}<rate_limit sense="incr"> 30 </rate_limit>'
    '<rate_limit sense="decr"> -2 </rate_limit>',
    "actuator-hysteresis": f"{_INPUT}<hysteresis_width> 0.3 </hysteresis_width>",
    "lag_filter-zero": f"{_INPUT}<c1> -240 </c1>",
    "lead_lag_filter-zero": f"{_INPUT}<c1> 1 </c1><c2> 1 </c2><c3> 0 </c3><c4> 0 </c4>",
    "second_order_filter-own": f"{_INPUT}<c1> 0.1 </c1><c2> 2 </c2><c3> 30 </c3><c4> 1 </c4>"
    "<c5> 5 </c5><c6> 30 </c6>",
    "washout_filter-own": f"{_INPUT}<c1> 3 </c1>",
    "integrator-own": f"{_INPUT}<c1> 0.7 </c1>",
}


def _component(node):
    """Return the children of a component as text, or nothing where they are not all numbers."""
    parts = []
    for child in node:
        if child.tag in ("input", "output", "description", "documentation"):
            continue
        if child.tag in ("trigger", "delay", "init", "function", "test", "default"):
            return ""
        words = [each.text or "" for each in child.iter() if each.tag != "independentVar"]
        if child.tag not in ("traverse", "noscale") and not all(map(_NUMBERS.fullmatch, words)):
            return ""
        if child.tag == "clipto" and node.tag in f"{FILTERS} actuator".split():
            continue
        for each in child.iter("independentVar"):
            if each.attrib:
                return ""
            each.text = "made/y"
        for each in child.iter():
            if _NUMBERS.fullmatch(each.text or "") and len(words := (each.text or "").split()) == 1:
                each.text = f" {float(words[0])!r} "  # the same number, however it is written
            each.tail = None
        parts.append(ElementTree.tostring(child, "unicode").strip())
    return " ".join([_INPUT, *parts])


def _roots():
    for file in sorted(Path(SHARED_FILES).rglob("*.xml")):
        try:
            yield ElementTree.parse(file).getroot()
        except ElementTree.ParseError:
            continue


class Both:
    """Expressions in JSBSim and compiled.

    Attributes:
        names: of the K expressions.
    """

    def __init__(self, folder, texts, parts):
        """Make an aircraft with functions, by name, and with components."""
        lines = (
            f'<function name="made/f{k}">{text}</function>' for k, text in enumerate(texts.values())
        )
        values = "".join(f'<property value="0"> {name} </property>' for name in INPUTS)
        named = "".join(text.replace("#", f"made/c{k}") for k, text in enumerate(parts))
        channel = f'<channel name="made">{named}</channel>' if parts else ""
        self.folder = make(
            folder,
            "made",
            [
                ('<axis name="DRAG">', "".join(lines) + '<axis name="DRAG">'),
                (
                    "</flight_control>",
                    f'</flight_control><system name="made">{values}{channel}</system>',
                ),
            ],
        )
        self.names = [*texts, *parts]
        self._columns = [
            *(f"made/f{k}" for k in range(len(texts))),
            *(f"made/c{k}" for k in range(len(parts))),
        ]

    def jsbsim(self, arguments):
        """Return the values (N, K) of arguments (N, 3)."""
        model = load(self.folder, 200)
        model.fdm.run_ic()
        model.fdm.set_dt(DT)
        writes = [model.node(name).set_double_value for name in INPUTS]
        reads = [model.node(name).get_double_value for name in self._columns]
        values = np.empty((len(arguments), len(reads)))
        for k, row in enumerate(arguments.tolist()):
            for write, number in zip(writes, row, strict=True):
                write(number)
            model.fdm.run()
            values[k] = [read() for read in reads]
        return values

    def source(self):
        """Return the compiled functions as source, and the indices of those that are translated."""
        source, reasons = StepSource(lambda _: None), list[str]()
        root = read_aircraft(self.folder, reasons)
        assert not reasons
        source.declare(*INPUTS)
        chosen, results = [], []
        made = [
            each
            for each in root.child("aerodynamics").all("function")
            if "made/" in each.attributes["name"]
        ]
        (system,) = (each for each in root.all("system") if each.attributes["name"] == "made")
        made += [each for channel in system.all("channel") for each in channel.children]
        for k, node in enumerate(made):
            if node.tag == "function":
                results.append(source.assign(expression(node, source)))
            else:
                try:
                    component(node, source)
                except NotTranslated:
                    continue
                results.append(source.variable(component_name(node)))
            chosen.append(k)
        inputs = {source.variable(name) for name in INPUTS}
        states = [v for each in source.loaded() if (v := source.variable(each)) not in inputs]
        first = "\n".join(f"    {each} = 0.0" for each in states)
        reads = "\n".join(
            f"        {source.variable(n)} = arguments[i, {k}]" for k, n in enumerate(INPUTS)
        )
        step = "\n".join(f"        {line}" for line in source.lines())
        writes = "\n".join(f"        values[i, {k}] = {each}" for k, each in enumerate(results))
        function = (
            "def evaluate(arguments, values, dt):\n    one = 1.0 + 0.0 * dt\n"
            f"{first}\n    for i in range(len(arguments)):\n{reads}\n{step}\n{writes}\n"
        )
        return "\n\n\n".join([_HEADER, *source.helpers, function]), chosen

    def compiled(self, arguments, change=lambda text: text):
        """Return the values (N, K) of compiled functions, and their indices (K,)."""
        text, chosen = self.source()
        text = change(text)
        name = f"run_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
        run = entry_of_source(name, text.replace("def evaluate(", f"def {name}("))
        values = np.empty((len(arguments), len(chosen)))
        run(arguments, values, DT)
        return values, chosen


def arguments_of(count, *, special, seed=1):
    """Draw arguments (N, 3): ordinary ones, of all magnitudes, and all pairs of special ones."""
    random = np.random.default_rng(seed)
    drawn = random.uniform(-3.0, 3.0, (count, 3))
    drawn[count // 3 : 2 * count // 3] = random.uniform(0.0, 1.0, (2 * count // 3 - count // 3, 3))
    wide = slice(2 * count // 3, count, 4)
    shape = drawn[wide].shape
    drawn[wide] = random.choice([-1.0, 1.0], shape) * np.exp(random.uniform(-740.0, 709.0, shape))
    if special:
        x, y = (each.ravel() for each in np.meshgrid(SPECIAL, SPECIAL))
        pairs = np.stack([x, y, random.choice(SPECIAL, x.shape)], axis=1)
        drawn = np.concatenate([drawn, pairs])
    return drawn


def differing(ours, theirs):
    """Return the number of arguments (K,) at which functions differ, by their bits."""
    same = (ours.view(np.int64) == theirs.view(np.int64)) | (np.isnan(ours) & np.isnan(theirs))
    return (~same).sum(axis=0)
