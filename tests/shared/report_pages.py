"""Parse the HTML of reports, and measure it in a browser."""

import json
import re
import shutil
import subprocess
from html import unescape
from html.parser import HTMLParser

from waiting import TIMEOUT_S

MAX_BYTES = 5_000_000
VOID = {"meta", "link", "br", "img", "use", "path"}


class Reader(HTMLParser):
    """Parse figures, tables and links of a page; tags must be closed in order."""

    def __init__(self, text):
        super().__init__()
        self.figures, self.labels, self.links, self.fetched, self.tags = [], [], [], [], set()
        self.tables, self._open, self._cell = [], [], None
        self.feed(text)
        assert not self._open

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.tags.add(tag)
        if tag not in VOID:
            self._open.append(tag)
        if tag == "figure":
            self.figures.append(values["id"].removeprefix("figure-"))
        if tag == "svg":
            self.labels.append(values["aria-label"])
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self._cell = ""
        if tag == "a":
            self.links.append(values["href"])
        elif "src" in values or "href" in values:
            self.fetched.append(values.get("src") or values["href"])

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag):
        if tag in VOID:
            return
        assert self._open.pop() == tag
        if tag in ("td", "th"):
            self.tables[-1][-1].append(self._cell)
            self._cell = None

    def handle_data(self, data):
        if self._cell is not None:
            self._cell += data


def stands_alone(text):
    """Parse a page, and assert that it needs no scripts and no external resources."""
    page = Reader(text)
    assert len(page.labels) == len(page.figures) == text.count("<figcaption>")
    assert all(len(label) > 40 for label in page.labels)
    assert "script" not in page.tags
    assert not [each for each in page.fetched if not each.startswith(("data:", "#"))]
    assert not re.search(r"url\((?!#)|@import", text)
    for link in page.links:
        assert link.startswith("data:") or f'id="{link[1:]}"' in text
    named = re.findall(r' id="([^"]*)"', text)
    assert len(named) == len(set(named))
    assert {*re.findall(r"url\(#([^)]*)\)", text), *re.findall(r'href="#([^"]*)"', text)} <= {
        *named
    }
    assert len(text.encode()) < MAX_BYTES
    return page


CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
NEEDS_CHROMIUM = "needs Chromium: on Debian, apt-get install chromium"
# sizes in pixels as the browser drew them, written to an attribute of the dumped page
MEASURE = """<script>
addEventListener("load", () => {
  const sizes = {};
  for (const figure of document.querySelectorAll("figure")) {
    const plot = figure.querySelector("svg"), box = plot.getBoundingClientRect();
    const drawn = plot.querySelector("g").getBBox(), text = plot.querySelectorAll("text").length;
    sizes[figure.id] = [box.width, box.height, drawn.width, drawn.height, text];
  }
  const wide = document.documentElement.scrollWidth - innerWidth;
  document.body.style.width = "400px";  // as wide as a telephone
  const narrow = {scrolled: 0, shaded: 0, over: document.body.scrollWidth - 400, heights: []};
  for (const text of document.querySelectorAll("svg text"))
    narrow.heights.push(text.getBoundingClientRect().height);
  for (const box of document.querySelectorAll(".wide"))
    if (box.scrollWidth > box.clientWidth) {
      narrow.scrolled += 1;
      narrow.shaded += getComputedStyle(box).backgroundAttachment.includes("scroll");
    }
  document.body.dataset.found = JSON.stringify({sizes, wide, narrow});
});
</script>"""


def measure(text, folder):
    """Return what a script finds in a page that a browser shows, without messages."""
    (folder / "page.html").write_text(text.replace("</body>", MEASURE + "</body>"), "utf-8")
    done = subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1200,900",
            f"--user-data-dir={folder / 'profile'}", "--enable-logging=stderr", "--log-level=0",
            "--virtual-time-budget=2000", "--dump-dom", (folder / "page.html").as_uri(),
        ],
        capture_output=True, text=True, timeout=TIMEOUT_S, check=True,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr
    return json.loads(unescape(re.search(r'data-found="([^"]*)"', done.stdout)[1]))


def browse(text, folder):
    """Measure the figures of a page in a browser, by name; return what a narrow page has, too.

    Asserts that there are no console messages.
    """
    found = measure(text, folder)
    names = {name.removeprefix("figure-"): size for name, size in found["sizes"].items()}
    for width, height, drawn_width, drawn_height, words in names.values():
        assert width > 900 and height > 150 and words > 10
        # in points; the width of a figure is 792
        assert drawn_width > 500 and drawn_height > 100
    assert found["wide"] <= 0
    return names, found["narrow"]
