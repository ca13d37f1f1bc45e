"""Which tests run: not those of other shards, nor of files that are unchanged since they passed."""

import os
from collections import defaultdict

import pytest
import shards
import stamps


class Selection:
    """The tests that run. With several processes the first one decides, and counts the results."""

    def __init__(self, config):
        self.root = config.rootpath
        self.worker = getattr(config, "workerinput", None)
        options = config.option
        some = options.keyword or options.markexpr or any("::" in each for each in config.args)
        self.stamps = not some and stamps.wanted()  # some tests of a file do not stand for it
        self.left_out = None  # tests of files that are left out, by file
        self.expected, self.results = defaultdict(set), defaultdict(dict)
        self.seconds = defaultdict(float)  # by file

    def find_left_out(self):
        if self.left_out is None:
            if self.worker is not None:
                self.left_out = self.worker["left_out"]
            else:
                self.left_out = stamps.unchanged() if self.stamps else {}
        return self.left_out

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node):
        node.workerinput["left_out"] = self.find_left_out()

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items):
        left_out = self.find_left_out()
        part, of = map(int, os.environ.get("TESTBED_SHARD", "1/1").split("/"))
        names = {item.path: item.path.relative_to(self.root).as_posix() for item in items}
        chosen = shards.files_of(part, of, names.values())
        items[:] = (
            each for each in items if str(each.path) not in left_out and names[each.path] in chosen
        )
        self.expect(item.nodeid for item in items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids):
        self.expect(ids)

    def expect(self, names):
        for name in names:
            self.expected[name.partition("::")[0]].add(name)

    def pytest_runtest_logreport(self, report):
        name = report.nodeid.partition("::")[0]
        of_file = self.results[name]
        self.seconds[name] += report.duration
        of_file[report.nodeid] = of_file.get(report.nodeid, True) and report.outcome != "failed"

    def pytest_sessionfinish(self, session, exitstatus):
        if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED and self.left_out:
            session.exitstatus = pytest.ExitCode.OK
        if self.worker is None and os.environ.get("TESTBED_SECONDS"):
            shards.write_seconds(self.seconds)
        if self.worker is None and self.stamps:
            whole = {k: v for k, v in self.results.items() if v.keys() == self.expected[k]}
            passed = {self.root / k: len(v) for k, v in whole.items() if all(v.values())}
            failed = {self.root / k for k, v in self.results.items() if not all(v.values())}
            stamps.write_stamps(passed, failed)

    def pytest_terminal_summary(self, terminalreporter):
        if self.left_out:
            terminalreporter.write_line(
                f"{sum(self.left_out.values())} tests of {len(self.left_out)} files are unchanged "
                "since they passed, and were left out: ALL=1 runs them"
            )
