"""Style sheet of the pages: light, dark and printed."""

from __future__ import annotations

from collections.abc import Iterable

from testbed.views.palette import ON_DARK, ON_WHITE


def _curve_colours(colours: Iterable[str]) -> str:
    """Set the CSS variables of the colours of curves."""
    return " ".join(f"--{name}: {each};" for name, each in zip(ON_WHITE, colours, strict=False))


STYLE = (
    """
:root {
  color-scheme: light dark;
  --paper: #ffffff; --ink: #16191d; --soft: #555d66; --rule: #d9dde2; --wash: #f5f6f8;
  --grid: #e3e5e8; --grey: #7f858c; --path: #c4c4c4; --good: #00704f; --bad: #b03a00;
  --shade: rgb(0 0 0 / 22%); --stripe: rgb(90 105 125 / 6%); CURVES ON WHITE
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14171a; --ink: #e7eaed; --soft: #a3abb3; --rule: #373d43; --wash: #1c2024;
    --grid: #2d3237; --grey: #8f979f; --path: #454c54; --good: #4fd0a5; --bad: #ff9d66;
    --shade: rgb(255 255 255 / 28%); --stripe: rgb(160 180 200 / 6%); CURVES ON DARK
  }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body {
  margin: 0 auto; max-width: 68rem; padding: 2.2rem 1.4rem 4rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.55 system-ui, "Segoe UI", "DejaVu Sans", Arial, sans-serif;
}
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .7rem; padding-top: .9rem;
  border-top: 1px solid var(--rule); }
h3 { font-size: 1.05rem; margin: 1.9rem 0 .3rem; }
p { max-width: 46rem; margin: .5rem 0; }
a { color: var(--blue); }
.question { font-size: 1.12rem; color: var(--soft); }
.meta { color: var(--soft); margin: .2rem 0 1rem; }
.outcome { font-weight: 600; color: var(--ink); border: 1px solid currentColor;
  border-radius: .3rem; padding: .05rem .45rem; }
.outcome.completed { color: var(--good); }
.outcome.lost, .outcome.envelope_exceeded, .outcome.formation_lost,
.outcome.separation_lost, .outcome.failed { color: var(--bad); }
nav { display: flex; flex-wrap: wrap; gap: .2rem 1rem; margin: .6rem 0 1.4rem; font-size: .95rem; }
nav a { white-space: nowrap; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: .8rem;
  margin: 1.2rem 0; padding: 0; list-style: none; }
.cards li { background: var(--wash); border: 1px solid var(--rule); border-radius: .5rem;
  padding: .7rem .9rem; }
.cards b { display: block; font-size: 1.45rem; font-weight: 650;
  font-variant-numeric: tabular-nums; }
.cards span { color: var(--soft); font-size: .88rem; overflow-wrap: anywhere; }
.cards li.bad { border: 2px solid var(--bad); }
.cards .bad b, .cards em { color: var(--bad); }
.cards em { display: block; font-size: .88rem; font-style: normal; font-weight: 600; }
summary { cursor: pointer; color: var(--soft); font-size: .92rem; }
/* What scrolls sideways has a shadow at each end that is cut off: covers scroll, shadows stay. */
.wide { overflow-x: auto; margin: .8rem 0; background:
  linear-gradient(to right, var(--paper) 40%, transparent) left / 2.5rem 102% no-repeat local,
  linear-gradient(to left, var(--paper) 40%, transparent) right / 2.5rem 102% no-repeat local,
  linear-gradient(to right, var(--shade), transparent) left / 1rem 100% no-repeat scroll,
  linear-gradient(to left, var(--shade), transparent) right / 1rem 100% no-repeat scroll; }
figure .wide { margin: 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .94rem; }
th, td { padding: .28rem .8rem; text-align: right; vertical-align: bottom; }
thead th { border-bottom: 1.5px solid var(--soft); font-weight: 600; line-height: 1.3; }
th:first-child { text-align: left; padding-left: .2rem; }
tbody th { font-weight: 500; }
table:not(.facts) th:first-child { white-space: nowrap; }
tbody tr:nth-child(even) { background: var(--stripe); }
tr.ends > * { border-bottom: 1px solid var(--rule); }
.facts th, .facts td { text-align: left; vertical-align: top; }
.green { color: var(--good); } .red { color: var(--bad); } .yellow { color: var(--bad); }
.dim { color: var(--soft); } .bold { font-weight: 650; }
figure { margin: .4rem 0 2rem; break-inside: avoid; }
figcaption { color: var(--soft); font-size: .92rem; max-width: 50rem; margin-top: .3rem; }
.plot { width: 100%; height: auto; display: block; }
.plot text { fill: var(--ink); font-family: inherit; }
@media screen { .plot { min-width: 44rem; } } /* text stays readable: narrow screens scroll */
pre { background: var(--wash); border: 1px solid var(--rule); border-radius: .5rem;
  padding: .8rem 1rem; overflow: auto;
  font: .84rem/1.45 ui-monospace, "DejaVu Sans Mono", monospace; }
pre.file { max-height: 26rem; }
code { font: .9em ui-monospace, "DejaVu Sans Mono", monospace; }
footer { margin-top: 3rem; color: var(--soft); font-size: .85rem; }
@page { size: A4; margin: 14mm; }
@media print {
  :root {
    --paper: #ffffff; --ink: #000000; --soft: #444444; --rule: #bbbbbb; --wash: #ffffff;
    --grid: #dddddd; --grey: #777777; --path: #c4c4c4; --good: #005c41; --bad: #8f2f00;
    CURVES ON WHITE
  }
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  nav, .screen { display: none; }
  .wide, pre, pre.file { overflow: visible; max-height: none; background: none; }
  pre { white-space: pre-wrap; font-size: 7.5pt; }
  h2, h3 { break-after: avoid; }
  tr, .cards li { break-inside: avoid; }
}
""".strip()
    .replace("CURVES ON WHITE", _curve_colours(ON_WHITE.values()))
    .replace("CURVES ON DARK", _curve_colours(ON_DARK))
)
