"""A companion as a process, and each way in which it, its autopilot or the others can fail."""

import os
import resource
import secrets
import signal
import time
from contextlib import suppress

import pytest
from commands import call_command
from companion_stand_in import FBWA, GUIDED, LOITER, RATE_HZ, StandIn
from waiting import TIMEOUT_S

from testbed.mavlink.codec import Codec
from testbed.mavlink.signing import MessageSigner, Signing, signing_time

KEY = bytes(range(32))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """One companion for all tests of this file that leave it running."""
    made = StandIn(tmp_path_factory.mktemp("companion"))
    yield made
    made.close()


def leave(world, within_s):
    """Let time pass after a fault; return how long commands went on, s, and what was said."""
    begun, heard = world.now_s, len(world.texts)
    assert world.fly(within_s, lambda: any("formation left" in t for t in world.texts[heard:])), (
        world.texts[-3:]
    )
    last = world.attitudes[-1] - begun
    return last, next(each for each in world.texts[heard:] if "formation left" in each)


def nothing_follows(world, duration_s):
    """Let time pass with all as before, without a switch of the pilot's: nothing is commanded."""
    before = len(world.attitudes)
    world.fly(duration_s)
    assert len(world.attitudes) == before


@pytest.fixture(autouse=True)
def mended(request):
    """Mend the world after a test that has failed, too."""
    yield
    if "world" in request.fixturenames:
        mend(request.getfixturevalue("world"))


def silent(world):
    world.silent = True


def frozen(world):
    world.frozen = True


def jumping(world):
    world.jump_m = 30.0


def leader_silent(world):
    world.mute = {"leader"}


def leader_jumping(world):
    world.leader_m = 40.0


def wrong_page(world):
    world.digests = 0xFF


def other_parameters(world):
    world.digests = 0xFF << 32


def late_clock(world):
    world.leader_ms = 1000


def mend(world):
    world.silent = world.frozen = False
    world.jump_m = world.leader_m = 0.0
    world.mute, world.digests, world.leader_ms = set(), 0, 0
    world.noise, world.again, world.obeys = 0, False, True
    with suppress(ProcessLookupError):
        world.process.send_signal(signal.SIGCONT)


# what fails, the reason, within which time, and whether a mode is asked for
FAILURES = [
    (silent, "", 1.0, False),
    (frozen, "position frozen", 0.5, True),
    (jumping, "position jumped 30 m", 0.0, True),
    (leader_silent, "leader silent", 1.0, True),
    (leader_jumping, "leader jumped", 0.0, True),
    (wrong_page, "has other scenario", 0.0, True),
    (other_parameters, "has other parameters", 0.0, True),
    (late_clock, "leader", 1.0, True),  # its clock, or a jump by what it flies in this time
]
# in `make test` one of them, and of the others the ways in test_engagement.py
ALL = bool(os.environ.get("TESTBED_FAILURES"))
SAMPLE = FAILURES if ALL else [each for each in FAILURES if each[0] is leader_silent]
STAYS_S = 2.0 if ALL else 1.0  # in which nothing may be commanded, or all must be
LATE_S = 0.6  # of a busy computer, beyond the bound


@pytest.mark.parametrize(("fault", "reason", "bound_s", "asks"), SAMPLE)
def test_failure_ends_the_commands_with_its_reason(world, fault, reason, bound_s, asks):
    world.engage()
    fault(world)
    lasted, text = leave(world, bound_s + 2)
    assert reason in text
    assert lasted <= bound_s + LATE_S
    world.fly(0.6 if asks else 3.0)  # beyond the time in which a mode may be asked for
    assert world.modes == ([LOITER] if asks else [])
    mend(world)
    nothing_follows(world, STAYS_S)
    assert world.modes == ([LOITER] if asks else []) and not world.arms


def test_pilot_ends_it_by_any_mode(world):
    world.engage()
    world.mode = FBWA
    assert "by the pilot" in leave(world, 2)[1]
    nothing_follows(world, 0)
    assert not world.modes


@pytest.mark.skipif(not ALL, reason="TESTBED_FAILURES=1 runs it; in one process: test_control_loop")
def test_mode_that_is_refused_is_asked_for_once(world):
    world.engage()
    world.obeys = False
    leader_silent(world)
    leave(world, 3)
    world.fly(4)
    assert world.modes == [LOITER] and world.mode == GUIDED
    mend(world)
    nothing_follows(world, STAYS_S)


def test_noise_and_repeated_messages_change_nothing(world):
    world.engage()
    world.noise, world.again = 20, True
    begun, before = len(world.attitudes), len(world.texts)
    world.fly(1.5)  # those of the second before are sent again
    mend(world)
    assert len(world.attitudes) - begun > 0.7 * 1.5 * RATE_HZ
    assert world.texts[before:] == [] and not world.modes


def test_stopped_and_continued_it_has_left(world):
    world.engage()
    world.process.send_signal(signal.SIGSTOP)
    world.fly(1.2)
    before = len(world.attitudes)
    world.process.send_signal(signal.SIGCONT)
    assert "paused" in leave(world, 3)[1]
    assert len(world.attitudes) <= before + 1  # one that was on its way
    nothing_follows(world, STAYS_S)
    assert not world.modes


def test_killed_and_started_again_it_is_disengaged(world):
    """The last test with this companion."""
    world.engage()
    world.process.kill()
    world.process.wait(TIMEOUT_S)
    world.fly(0.2)
    before, heard = len(world.attitudes), len(world.texts)
    world.start()
    assert world.fly(60, lambda: "refused: GUIDED was on" in "".join(world.texts[heard:]))
    world.fly(STAYS_S)
    assert len(world.attitudes) == before and not world.modes
    world.engage()
    world.process.send_signal(signal.SIGTERM)
    world.fly(3, lambda: world.process.poll() is not None)
    assert world.modes == [LOITER]  # a signal leaves first
    assert world.process.wait(TIMEOUT_S) == 0


def signer(key, link, ahead_s=0.0):
    now = signing_time(time.time() + ahead_s)
    return MessageSigner(Signing(key, link=link, time=now, strict=True))


@pytest.fixture(scope="module")
def signed(tmp_path_factory):
    """A companion with a key and a log."""
    folder = tmp_path_factory.mktemp("signed")
    key = folder / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    signers = {name: signer(KEY, link) for link, name in enumerate(("leader", "uav1", "uav2"), 3)}
    made = StandIn(folder, "--out", str(folder / "log"), key=key, signers=signers, log=True)
    yield made
    made.close()


def test_full_disk_ends_the_log_and_no_flight(signed):
    signed.engage()
    assert "warning" not in signed.printed()
    size = sum(each.stat().st_size for each in (signed.folder / "log").iterdir())
    resource.prlimit(signed.process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    assert signed.fly(30, lambda: "warning" in signed.printed())
    before = len(signed.attitudes)
    signed.fly(STAYS_S)
    assert len(signed.attitudes) - before > 0.7 * STAYS_S * RATE_HZ


def test_forged_frames_are_refused_with_a_key(signed):
    """The last test with this companion."""
    signed.engage()
    for forged in (Codec(1, 191), Codec(1, 191, signer(secrets.token_bytes(32), 3, 30.0))):
        signed.forged, signed.again = forged, True
        before = len(signed.attitudes)
        signed.fly(1.2)  # the messages of the second before are sent again
        assert len(signed.attitudes) - before > 0.7 * 1.2 * RATE_HZ
    assert not signed.modes
    signed.forged = Codec(1, 191, signer(KEY, 9))  # control: with the key it is believed
    try:
        assert "leader jumped" in leave(signed, 3)[1]
    finally:
        signed.forged, signed.again = None, False
    signed.process.send_signal(signal.SIGTERM)
    assert signed.process.wait(TIMEOUT_S) == 0  # although its log has ended


def test_off_loopback_it_needs_a_key_or_unsigned(tmp_path):
    for address in ("serial:/dev/null:57600", "udpin:0.0.0.0:14999"):
        command = ["companion", "simulation-3", "--as", "uav2", "--autopilot", address]
        command += ["--formation", "multicast:239.255.41.1:14998"]
        done = call_command(*command, cwd=tmp_path, code=2, columns=200)
        assert "--mavlink-key" in done.stderr and "--unsigned" in done.stderr
        assert os.listdir(tmp_path) == []
