"""A message that is far too large: neither memory nor the service may go with it, whoever sends it."""

from pathlib import Path

import zenoh

from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.telemetry import Reason
from tests.benchmarks.processes import rss_kb
from tests.support.secured import Secured

BIG = 50_000_000
AT_MOST_MB = 15


def test_messages_of_50_mb_cost_no_memory(tmp_path: Path) -> None:
    """Without a limit, each was put together before access control looked at it: from 70 to 120 MB for one of these."""
    with Secured(tmp_path) as secured, secured.client("anna") as anna:
        # The file's own limit holds where it is used by others, such as a router; here it is the service's that counts.
        assert anna.start_leg(3, 90, 90, 90).accepted
        before_mb = rss_kb(secured.gateway.child.pid) / 1024
        for name in ("otto", "anna"):
            with secured.session(name) as session:
                session.put(keys.ESTOP, bytes(BIG), congestion_control=zenoh.CongestionControl.BLOCK)
        # Both are dropped, with or without their links; who asks for no more than the gateway takes is answered.
        with secured.client("anna") as again:
            ack = again.ask(keys.leg_command(3), {"x": "x" * (2 * MAX_PAYLOAD_BYTES)})
            assert ack.reason is Reason.TOO_LARGE
            assert again.estop().stop_frames == 6
        most_mb = rss_kb(secured.gateway.child.pid, "VmHWM") / 1024
        print(f"memory: {before_mb:.0f} MB before, {most_mb:.0f} MB at most")
        assert most_mb - before_mb < AT_MOST_MB
