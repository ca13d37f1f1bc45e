"""A client that dies in flight: the run continues, and its log is complete."""

from external_run import event_texts, start_run
from mavlink_client import MavlinkClient

EXTERNAL = "--set=fleet.2.commanded_by={kind: external, failsafe_s: 0.5}"
SECONDS = 6.0
UAV3 = 4  # its system


def test_dead_client_leaves_run_and_log_complete(tmp_path):
    with MavlinkClient() as client:
        arguments = (f"--mavlink={client.address}", "--pace=4", f"--duration={SECONDS}", EXTERNAL)
        with start_run(tmp_path / "flight", *arguments) as flight:
            for message in client.messages_until_end(flight):
                if message.name == "ATTITUDE" and message.system == UAV3:
                    if message.number("time_boot_ms") > 2000:
                        break
                    client.attitude(UAV3, 0.1, 0.0, 0.5)
            client.__exit__()  # closes its port
            metrics = flight.end(0)
    assert metrics["outcome"] == "completed" and metrics["simulated_s"] == SECONDS
    assert metrics["mavlink"]["clients"] == ["250.190"]
    assert [
        text for text in event_texts(metrics, "uav3") if "receives no commands for 0.5 s" in text
    ]
    log = flight.log()
    assert log.finished and log.time_s[-1] == SECONDS
