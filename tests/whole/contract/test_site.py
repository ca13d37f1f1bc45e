"""The documentation site: it builds without a warning, stands alone, and leaves nothing out."""

import html
import importlib
import json
import posixpath
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from subprocess import PIPE
from urllib.parse import unquote

import pytest
from cases import ALL, some
from commands import environment
from places import ROOT
from report_pages import CHROMIUM, NEEDS_CHROMIUM
from typer.testing import CliRunner
from waiting import TIMEOUT_S

import testbed
from testbed.cli.main import app
from testbed.scenario import json_schema

HEAVY = {
    "numpy",
    "numba",
    "scipy",
    "matplotlib",
    "jsbsim",
    "mcap",
    "foxglove",
    "pymavlink",
    "rerun",
}
REFERENCE = ("commands", "equations", "python", "scenario")
CODE = ("scenarios/simulation-3.yaml", "aircraft/skywalker_x8/middle_loop.yaml")  # shown whole
WHOLE = ("index.md", "ci.md", "air.md", *(f"reference/{each}.md" for each in REFERENCE))
LINKED = (
    *("README.md", "SECURITY.md", "CHANGELOG.md", "testbed/formation/paper.md"),
    *(f"paper/{each}.md" for each in ("README", "gap", "leader-acceleration")),
    *("action.yml", ".github/workflows/check.yml", "scenarios/own-law-repulsion.yaml", *CODE),
)
BUILDER = """
import contextlib, io, json, os, pathlib, sys
import build, python_reference
python_reference.ROOT = pathlib.Path(sys.argv[1])
for line in sys.stdin:
    sys.argv[1:], os.environ["REPOSITORY_URL"] = json.loads(line)
    with contextlib.redirect_stdout(sys.stderr), contextlib.redirect_stderr(io.StringIO()) as said:
        code = build.main()
    print(json.dumps([code, said.getvalue(), sorted(sys.modules)]), flush=True)
"""
SOURCES = "https://git.example/group/testbed"
CONFIG = """
[project]
site_name = "pages"
docs_dir = "docs"
site_dir = "site"
use_directory_urls = false
nav = ["index.md"]
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Where the package is of which the reference is written; with `ALL` all of it.

    Otherwise the modules that the reference names: reading all of them takes ten times as long.
    """
    if ALL:
        return ROOT
    root = tmp_path_factory.mktemp("package")
    names = {getattr(testbed, each).__module__ for each in set(testbed.__all__) - {"__version__"}}
    for page in WHOLE:
        text = (ROOT / "docs" / page).read_text(encoding="utf-8")
        names |= set(re.findall(r"^::: ([\w.]+)", text, re.M))
    for name in {*names, "testbed.core.version"}:
        for path in (Path(*name.split(".")), *Path(*name.split(".")).parents[:-1]):
            for file in (path / "__init__.py", path.with_suffix(".py")):
                if (ROOT / file).is_file():
                    (root / file).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy(ROOT / file, root / file)
    return root


@pytest.fixture(scope="module")
def build(package):
    """Function that builds the site of a repository: exit code, errors, modules; one process."""
    pytest.importorskip("zensical", reason="make setup installs it: the extra docs")
    command = [sys.executable, "-B", "-P", "-c", BUILDER, str(package)]
    place = {"cwd": package, "env": environment(80, ROOT / "website")}
    with subprocess.Popen(command, **place, stdin=PIPE, stdout=PIPE, text=True) as process:

        def build(repository, into, url=""):
            words = [str(repository), "--into", str(into)]
            print(json.dumps([words, url]), file=process.stdin, flush=True)
            return json.loads(process.stdout.readline())

        yield build
        process.stdin.close()
    assert process.returncode == 0


@pytest.fixture
def small(tmp_path):
    """A repository with one page."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "website").mkdir()
    (tmp_path / "docs/index.md").write_text("# Page\n\n## Part\n")
    (tmp_path / "website/zensical.toml").write_text(CONFIG)
    return tmp_path


def outline(text):
    """Return the headings of a page, and its other anchors."""
    text = re.sub(r"^ *(`{3,})[^\n]*\n.*?^ *\1 *$", "", text, flags=re.M | re.S)
    lines = re.findall(r'^#+ .*|<a id="[^"]+"></a>', text, re.M)
    return "\n\n".join(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", line) for line in lines) + "\n"


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    """What the site is made of, where most pages are outlines; with `ALL` all of it.

    Most of the time is taken by the files that whole pages link to.
    """
    if ALL:
        return ROOT
    root = tmp_path_factory.mktemp("repository")
    shutil.copytree(ROOT / "docs", root / "docs")
    (root / "website").symlink_to(ROOT / "website")
    for path in {*root.glob("docs/**/*.md")} - {root / "docs" / each for each in WHOLE}:
        path.write_text(outline(path.read_text(encoding="utf-8")), encoding="utf-8")
    for each in LINKED:
        (root / each).parent.mkdir(parents=True, exist_ok=True)
        text = (ROOT / each).read_text(encoding="utf-8")
        (root / each).write_text(outline(text) if each.endswith(".md") else text, encoding="utf-8")
    with (root / "docs" / "own-scenario.md").open("a", encoding="utf-8") as page:
        page.writelines(f"[a](../{each})\n" for each in ("scenarios", *LINKED))
    return root


@pytest.fixture(scope="module")
def site(build, repository, tmp_path_factory):
    """Where the site is, built strictly, and the modules that were loaded for it."""
    place = tmp_path_factory.mktemp("site")
    code, errors, modules = build(repository, place, SOURCES)
    assert code == 0, errors
    return place / "site", set(modules)


class Page(HTMLParser):
    """Where the links of a page lead, what can be linked to in it, and what it loads."""

    def __init__(self, text):
        super().__init__()
        self.links, self.anchors, self.loads = [], {""}, []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found.get("id"), found.get("name") if tag == "a" else None}
        if tag == "a" and found.get("href"):
            self.links.append(found["href"])
        elif tag in ("link", "script", "img", "iframe", "source"):
            self.loads += [found[key] for key in ("href", "src") if found.get(key)]


@pytest.fixture(scope="module")
def pages(site):
    place, _ = site
    return {
        path: Page(path.read_text(encoding="utf-8"))
        for path in place.rglob("*.html")
        if path.name != "404.html"  # its links are from the site's root
    }


def reference(site, name):
    return (site[0] / "reference" / f"{name}.html").read_text(encoding="utf-8")


def test_site_is_built_without_importing_the_product(site):
    _, modules = site
    assert {"griffe", "testbed.cli.main"} <= modules
    assert not HEAVY & modules


def test_every_page_of_the_docs_is_in_the_navigation(site, pages):
    place, _ = site
    links = pages[place / "index.html"].links
    navigation = {"index.html"} | {posixpath.normpath(link.partition("#")[0]) for link in links}
    docs = ROOT / "docs"
    ours = {path.relative_to(docs).with_suffix(".html") for path in docs.rglob("*.md")}
    assert len(ours) >= 20
    assert {path.as_posix() for path in ours} <= navigation


def test_linked_files_exist_with_those_named(monkeypatch):
    """Of the whole repository: the site of `make test` has most pages without their links."""
    monkeypatch.syspath_prepend(str(ROOT / "website"))
    linked_files = importlib.import_module("linked_files")
    pages = [path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")]
    linked = {linked_files.address(each.path) for each in linked_files.find_linked(ROOT, pages)}
    config = (ROOT / "website/zensical.toml").read_text(encoding="utf-8")
    named = set(re.findall(r'= "(repository/[^"]+)"', config))
    assert len(named) >= 5 and named <= linked


def test_every_link_leads_to_a_page_and_a_part_of_it(pages):
    followed = 0
    for path, page in pages.items():
        for link in page.links:
            if "://" in link or link.startswith("mailto:"):
                continue
            target, _, part = link.partition("#")
            there = (path.parent / unquote(target)).resolve() if target else path
            assert there in pages, (path, link)
            assert unquote(part) in pages[there].anchors, (path, link)
            followed += 1
    assert followed > 1000


def test_nothing_is_loaded_from_elsewhere(site, pages):
    place, _ = site
    assert not [(path, load) for path, page in pages.items() for load in page.loads if "//" in load]
    for path, page in pages.items():
        for load in page.loads:
            if not load.startswith(("data:", "#")):
                assert (path.parent / unquote(load.partition("?")[0])).is_file(), (path, load)
    for sheet in place.rglob("*.css"):
        assert not re.search(r"(@import|url\()\s*[\"']?(https?:)?//", sheet.read_text())


def test_files_outside_the_docs_are_shown_whole(site):
    place, _ = site
    for name in CODE:
        text = (place / "repository" / f"{name}.html").read_text(encoding="utf-8")
        (code,) = re.findall(r"<code>(.*?)</code></pre>", text, re.S)
        shown = html.unescape(re.sub(r"<[^>]+>", "", code))
        assert shown.strip() == (ROOT / name).read_text(encoding="utf-8").strip()


def keys(schema):
    """The keys of every map of the schema, those of maps without a name with their owner's."""
    named = {"": schema, **schema["$defs"]}
    for name, definition in named.items():
        waiting = [definition if name else {**definition, "$defs": {}}]
        while waiting:
            part = waiting.pop()
            if isinstance(part, dict):
                for key, inner in part.get("properties", {}).items():
                    yield name, key, inner
                waiting += [each for key, each in part.items() if key not in ("default", "enum")]
            elif isinstance(part, list):
                waiting += part


def test_reference_has_every_schema_key(site):
    text = reference(site, "scenario")
    rows = {
        row[1]: html.unescape(re.sub(r"<[^>]+>", "", row[0]))
        for row in re.finditer(r'<tr>\s*<td><code id="([^"]+)">.*?</tr>', text, re.S)
    }
    expected = list(keys(json_schema()))
    assert len(expected) > 300
    for name, key, inner in expected:
        mark = f"{re.sub(r'(?<=[a-z])(?=[A-Z])', '-', name).lower()}.{key}" if name else key
        assert mark in rows
        said = " ".join(inner.get("description", "").split())
        assert said in " ".join(rows[mark].split()), mark
    assert len(rows) == len({(name, key) for name, key, _ in expected})


def test_a_row_has_type_default_and_unit(site):
    text = reference(site, "scenario")
    row = re.search(r'<tr>\s*<td><code id="gps.latency_s">.*?</tr>', text, re.S)[0]
    cells = [re.sub(r"<[^>]+>", "", cell) for cell in re.findall(r"<td>(.*?)</td>", row, re.S)]
    assert [html.unescape(cell) for cell in cells[:4]] == [
        "latency_s",
        "number ≥ 0, ≤ 10",
        "0.12",
        "s",
    ]


def test_the_reference_has_every_command_and_option(site):
    text = html.unescape(reference(site, "commands"))
    listed = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    names = re.findall(r"^│ ([a-z][a-z-]*) ", listed, re.M)
    assert {"run", "view", "check", "import", "new"} <= set(names)
    for group in ("new", "benchmark"):  # of commands
        names.remove(group)
    names += ["new aircraft", "new law", "new study"]
    names += ["benchmark fly", "benchmark table", "benchmark verify"]
    parts = dict(
        re.findall(r"<h2 [^>]*>testbed ([a-z -]+)<.*?</h2>(.*?)(?=<h2 |</article>)", text, re.S)
    )
    assert sorted(parts) == sorted(names)
    for name in some(names, 12):
        helped = CliRunner().invoke(app, [*name.split(), "--help"], env={"COLUMNS": "200"}).output
        options = set(re.findall(r"^│ \*? *(--[a-z-]+)", helped, re.M)) - {"--help"}
        shown = set(re.findall(r"<code>(--[a-z-]+)", parts[name]))
        assert options == shown, name


def test_reference_has_the_public_names(site):
    text = reference(site, "python")
    for name in set(testbed.__all__) - {"__version__"}:
        assert f'id="testbed.{name}"' in text, name
    assert "m/s over the ground" in text  # behind VehicleState.velocity_ned


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[a](nowhere.md)", "docs/index.md:3: there is no docs/nowhere.md"),
        ("```text\n\n```\n[a](../testbed/x.py)", "docs/index.md:6: there is no testbed/x.py"),
        ("![a](images/x.png)", "docs/index.md:3: there is no docs/images/x.png"),
        ("[a](../../x.md)", "docs/index.md:3: there is no ../x.md in the repository"),
        ("<!-- made: everything -->", "docs/index.md: no generator for 'everything'"),
        ("::: testbed.Nobody", "docs/index.md: there is no testbed.Nobody"),
    ],
)
def test_a_page_that_leads_nowhere_is_an_error(build, small, text, said):
    page = small / "docs/index.md"
    page.write_text(f"# Page\n\n{text}\n")
    code, errors, _ = build(small, small / "build")
    assert code == 2 and said in errors and "Traceback" not in errors


def test_missing_parts_of_pages_are_errors(build, small):
    (small / "docs/index.md").write_text("# Page\n\n[a](#nobody)\n\n[a](index.md#nobody)\n")
    code, errors, _ = build(small, small / "build")
    assert code == 2 and "Traceback" not in errors
    assert "index.md:3" in errors and "index.md:5" in errors
    assert "repo_url" not in (small / "build/zensical.toml").read_text()


def test_navigation_and_pages_must_agree(build, small):
    (small / "docs/other.md").write_text("# Other\n")
    code, errors, _ = build(small, small / "build")
    assert (code, "nav lacks other.md" in errors) == (2, True)
    (small / "docs/other.md").rename(small / "docs/index.md")
    config = small / "website/zensical.toml"
    config.write_text(CONFIG.replace('"index.md"', '"index.md", "other.md"'))
    code, errors, _ = build(small, small / "build")
    assert (code, "nav has other.md: no page" in errors) == (2, True)


def test_pages_link_to_the_repository_if_it_is_known(site, pages):
    """Where it is not, the configuration has none: `test_missing_parts_of_pages_are_errors`."""
    text = (site[0] / "index.html").read_text(encoding="utf-8")
    assert "md-source__repository" in text
    assert all(SOURCES in page.links for page in pages.values())


def test_search_has_every_page(site, pages):
    """Those of the navigation; copies of code are left out."""
    place, _ = site
    index = json.loads((place / "search.json").read_text(encoding="utf-8"))
    found = {item["location"].partition("#")[0] for item in index["items"]}
    written = {path.relative_to(place).as_posix() for path in pages}
    assert {each for each in written if not each.startswith("repository/")} <= found
    assert "repository/index.html" in found  # README.md
    assert not [each for each in found if each.endswith((".py.html", ".yaml.html"))]
    offline = (place / "search.js").read_text(encoding="utf-8")
    assert offline.startswith("var __index = {")


def test_search_runs_in_pages_opened_as_files(tmp_path):
    """Its worker's script runs in a frame: messages arrive in order, as copies."""
    if CHROMIUM is None:
        pytest.skip(NEEDS_CHROMIUM)
    (tmp_path / "worker.js").write_text(
        "self.addEventListener('message', e => { e.data.n *= 2; self.postMessage(e.data); });"
    )
    (tmp_path / "page.html").write_text(f"""<!doctype html><body>
<script>{(ROOT / "website/iframe-worker.js").read_text(encoding="utf-8")}</script>
<script>
const given = {{n: 21}}, worker = new Worker("worker.js"), answers = [];
worker.onmessage = e => {{
  answers.push(e.data.n);
  if (answers.length === 1) worker.postMessage({{n: 4}});
  document.title = `answers ${{answers}} of ${{given.n}}`;
}};
worker.postMessage(given);
</script>""")
    done = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--virtual-time-budget=5000", "--dump-dom"]
        + [f"--user-data-dir={tmp_path / 'profile'}", (tmp_path / "page.html").as_uri()],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )
    assert "<title>answers 42,8 of 21</title>" in done.stdout


def test_long_commands_are_broken(site):
    """The style breaks lines of the fences that the docs use for commands."""
    style = (site[0] / "assets" / "site.css").read_text(encoding="utf-8")
    for kind, name in (("language-console", "ci"), ("language-sh", "air")):
        assert kind in (site[0] / f"{name}.html").read_text(encoding="utf-8")
        assert re.search(rf"\.{kind} pre > code[^}}]*pre-wrap", style)
