"""A ground station that dies in mid-flight: the flight goes on, and its log is whole."""

from outside_run import flying, said_events
from speaker import Speaker

EXTERNAL = "--set=fleet.2.commanded_by={kind: external, failsafe_s: 0.5}"
SECONDS = 6.0
UAV3 = 4  # its system


def test_a_client_that_dies_in_mid_flight_leaves_the_run_and_its_log_whole(tmp_path):
    with Speaker() as speaker:
        arguments = (f"--mavlink={speaker.address}", "--pace=2", f"--duration={SECONDS}", EXTERNAL)
        with flying(tmp_path / "flight", *arguments) as flight:
            for message in speaker.hear_while(flight):
                if message.name == "ATTITUDE" and message.system == UAV3:
                    if message.number("time_boot_ms") > 2000:
                        break
                    speaker.attitude(UAV3, 0.1, 0.0, 0.5)
            speaker.__exit__()  # nobody has its port any more
            metrics = flight.end(0)
    assert metrics["outcome"] == "flown" and metrics["simulated_s"] == SECONDS
    assert metrics["mavlink"]["clients"] == ["250.190"]
    assert [text for text in said_events(metrics, "uav3") if "hears no commands for 0.5 s" in text]
    log = flight.log()
    assert log.finished and log.time_s[-1] == SECONDS
