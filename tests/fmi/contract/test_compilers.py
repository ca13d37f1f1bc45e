"""Compilers are found by option or PATH, get little of the environment, and end with a line."""

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import call_command, environment
from fmi2_importer import MAC
from waiting import TIMEOUT_S, until

from testbed.core.errors import InputError
from testbed.fmi.compilers import find_cc, find_zig, link_library
from testbed.fmi.targets import THIS, targets

ENVIRONMENT = {"SECRET_TOKEN": "s3cret", "ZIG_GLOBAL_CACHE_DIR": "cache", "CC": "another"}


def program(folder, name, lines):
    path = folder / name
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def sources(tmp_path):
    (tmp_path / "one.c").write_text("int one(void) { return 1; }\n")
    return [tmp_path / "one.c"]


def test_compilers_come_from_option_or_path(tmp_path, monkeypatch):
    """Not from the environment variable CC, and not from the current directory."""
    monkeypatch.setenv("CC", str(program(tmp_path, "another", "")))
    monkeypatch.chdir(tmp_path)
    program(tmp_path, "cc", "")
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    with pytest.raises(InputError, match="there is no cc on PATH .install gcc or clang, or write"):
        find_cc(None)
    with pytest.raises(InputError, match="--target windows needs the compiler zig.*pip install"):
        find_zig(None, "windows")
    for name, find in (("cc", find_cc), ("python-zig", lambda option: find_zig(option, "macos"))):
        own = program(tmp_path / "bin", name, "")
        assert find(None) == str(own)
        assert find(tmp_path / "cc") == str(tmp_path / "cc")
        with pytest.raises(InputError, match="no such program that can be executed"):
            find(tmp_path / "one.c")


def test_compiler_gets_little_of_the_environment(tmp_path, monkeypatch, sources):
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "home").mkdir()
    seen = shlex.quote(str(tmp_path / "home" / "seen"))
    lines = f'env > {seen}; echo "$PWD $@" >> {seen}; echo made > library.so'
    link_library([str(program(tmp_path, "cc", lines))], sources, tmp_path / "library.so")
    text = (tmp_path / "home" / "seen").read_text()
    assert "s3cret" not in text and "CC=" not in text
    assert "ZIG_GLOBAL_CACHE_DIR=cache" in text and "PATH=" in text
    assert text.splitlines()[-1].startswith(f"{tmp_path} -std=c11")


def test_compiler_that_fails_is_one_error(tmp_path, sources):
    sources[0].write_text("int one(void) { return two; }\n")
    with pytest.raises(InputError, match=r"failed with exit code 1; it printed:\n    one.c:"):
        link_library([find_cc(None)], sources, tmp_path / "library.so")
    silent = program(tmp_path, "silent", "exit 0")
    with pytest.raises(InputError, match="silent: failed with exit code 0"):
        link_library([str(silent)], sources, tmp_path / "library.so")
    no_program = program(tmp_path, "broken", "")
    no_program.write_text("#!/nowhere/at/all\n")
    with pytest.raises(InputError, match="broken: cannot be started"):
        link_library([str(no_program)], sources, tmp_path / "library.so")


@pytest.mark.skipif(MAC, reason="looks at processes in /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_compiler_ends_with_the_command(tmp_path, number):
    """Also if the command is killed; its folder is then removed."""
    work = tmp_path / "work"
    work.mkdir()
    (work / "one.c").write_text("int one(void) { return 1; }\n")
    slow = program(tmp_path, "slow", f"echo $$ > {tmp_path}/started; exec sleep 600")
    code = (
        "from pathlib import Path; from testbed.fmi.compilers import link_library; "
        f"link_library(['{slow}'], [Path('{work}/one.c')], Path('{work}/library.so'))"
    )
    child = subprocess.Popen([sys.executable, "-c", code], env=environment(100))
    started = tmp_path / "started"
    until(lambda: started.is_file() and started.read_text().strip())
    compiler = Path("/proc") / started.read_text().strip()
    assert compiler.is_dir()
    child.send_signal(number)
    child.wait(TIMEOUT_S)
    until(lambda: not compiler.is_dir())
    if number == signal.SIGKILL:
        until(lambda: not work.exists())


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("--airspeed 15:25", "--airspeed 15:25: write a number such as 20, or several with commas"),
        ("--airspeed 25:15:1", "--airspeed 25:15:1: has no number"),
        ("--airspeed 0", "--airspeed 0: has 0; write 1 to 340 (m/s)"),
        ("--airspeed 20:40:0.1", "--airspeed 20:40:0.1: has 201 numbers (write at most 200)"),
        ("--airspeed 15:25:0.1 --height 1,2", "--airspeed 15:25:0.1: makes 202 starts"),
        ("--airspeed 20 --physics-hz 120", "--physics-hz 120: write a multiple of 50"),
        ("--airspeed 20 --cc nothing", "--cc nothing: there is no such program"),
        ("--airspeed 20 --target macos --zig nothing", "--zig nothing: there is no such program"),
        pytest.param(
            "--airspeed 20 --target linux-x86-64 --target host",
            "--target linux-x86-64 and host have one place in an FMU, linux64",
            marks=pytest.mark.skipif(targets()[THIS].folder != "linux64", reason="of this machine"),
        ),
        ("--airspeed 400:500:1", "--airspeed 400:500:1: has 400; write 1 to 340 (m/s)"),
    ],
)
def test_wrong_options_are_one_line(tmp_path, monkeypatch, words, text):
    (tmp_path / "bin").mkdir()
    program(tmp_path / "bin", "zig", "")
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    done = call_command(
        "fmu", "rascal110", *words.split(), "--out", "o", cwd=tmp_path, code=2, columns=200
    )
    assert done.stderr.startswith(f"error: {text}"), done.stderr
    assert done.stderr.count("\n") == 1 and not (tmp_path / "o").exists()


def test_files_of_the_user_are_not_replaced(tmp_path):
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "rascal110.fmu").write_text("mine")
    words = ("fmu", "rascal110", "--airspeed", "20", "--out", "o")
    done = call_command(*words, cwd=tmp_path, code=2, columns=200)
    assert "o/rascal110.fmu exists, and is not as the testbed wrote it" in done.stderr
    assert Path(tmp_path / "o" / "rascal110.fmu").read_text() == "mine"
