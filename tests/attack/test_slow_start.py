"""The network keeps the service from starting: the legs have been stopped before, and it ends when it is asked to."""

import json
import re
from pathlib import Path

from tests.support.gateway_process import Gateway, free_port

STOPPED = r"servo \d\d stopped"


def test_a_router_that_is_waited_for_holds_neither_stops_nor_the_end(tmp_path: Path) -> None:
    """So does a name server that does not answer, for ten seconds."""
    waiting = {"connect": {"endpoints": [f"tcp/127.0.0.1:{free_port()}"], "timeout_ms": -1, "exit_on_failure": True}}
    (tmp_path / "zenoh.json5").write_text(json.dumps(waiting))
    settings = {"zenoh": {"config": str(tmp_path / "zenoh.json5")}}
    with Gateway(tmp_path, settings, env={"PYTHONDEVMODE": "1"}, wait=False) as gateway:
        for leg in range(1, 7):
            gateway.child.wait_for_output(f"servo {leg}3 stopped")
        gateway.child.terminate()
        assert gateway.child.wait() == 0
        told = gateway.child.stderr
    assert "ready" not in gateway.child.stdout
    assert len(re.findall(STOPPED, told[told.index("the gateway ends") :])) >= 18
