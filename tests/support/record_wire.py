"""Records what a gateway sends, for every later version to read.

    python -m tests.support.record_wire tests/data/wire/1.4

One JSON payload a line, in a file for each kind. Every answer, mode, kind of event and cause that a simulated
controller can bring about is among them.
"""

import json
import os
import signal
import sys
import tempfile
import threading
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from gateway import certs
from gateway.client import Client
from schemas import keys
from tests.support.gateway_process import Gateway, free_port

LEG = {"servos": [{"op": "start", "angle_deg": 90}] * 3}
SET = {"servos": [{"op": "set", "angle_deg": 90}] * 3}
TOKENS = {"lease": keys.LEASE, "button": keys.BUTTON}
"""What is asked on these, with a token of that name."""
MOST_BURSTS = 100
BURST = 1000
"""Messages at once: far more than a ring keeps. How many of them wait in it at the same time is chance."""


def main(folder: Path) -> None:
    """Run a gateway, bring everything about, and write what was heard."""
    changed = threading.Condition()
    heard: dict[str, list[str]] = {
        name: [] for name in ("state", "config", "event", "frame", "ack", *TOKENS, "calibration")
    }
    settings: dict[str, dict[str, Any]] = {"telemetry": {"frames": True}, "limits": {"leg_rate_hz": 2}}
    with (
        tempfile.TemporaryDirectory() as scratch,
        Gateway(Path(scratch), settings) as gateway,
        gateway.client() as client,
    ):
        subscribers: list[Any] = [
            client.session.declare_subscriber(key, _into(heard[name], changed))
            for key, name in (
                (keys.STATE, "state"),
                (keys.CONFIG, "config"),
                (keys.EVENT, "event"),
                (keys.FRAME, "frame"),
                (keys.CALIBRATION, "calibration"),
            )
        ]

        def ask(key: str, payload: object) -> None:
            text = payload if isinstance(payload, str) else json.dumps(payload)
            for reply in client.session.get(key, payload=text, encoding="application/json", timeout=5):
                if reply.ok is not None:
                    heard["ack"].append(reply.ok.payload.to_string())

        def request(name: str, do: str, source: str | None = None, **more: str | int | None) -> str | None:
            fields = {"do": do, **({} if source is None else {"source": source}), **more}
            for reply in client.session.get(TOKENS[name], payload=json.dumps(fields), timeout=5):
                if reply.ok is not None:
                    heard[name].append(reply.ok.payload.to_string())
            token: str | None = json.loads(heard[name][-1]).get(name)
            return token

        lease, button = partial(request, "lease"), partial(request, "button")

        def wait_for(word: str, name: str) -> None:
            with changed:
                if not changed.wait_for(lambda: any(word in line for line in heard[name]), timeout=10):
                    raise TimeoutError(f"no {word} in {name}")

        ask(keys.leg_command(1), LEG)
        wait_for('"active"', "state")
        wait_for("watchdog_expired", "event")
        ask(keys.CALIBRATION_CMD, {"servos": {"32": {"trim_deg": -7.5, "inverted": True}}, "landing": {"11": 45}})
        ask(keys.CALIBRATION_CMD, {"servos": {"32": {"trim_deg": 400}}})
        wait_for('"revision":1', "calibration")
        rejected: list[object] = ["{", {"servos": []}, {"servos": [{"op": "set", "angle_deg": 1}] * 3}, " " * 5000]
        for payload in rejected:
            ask(keys.leg_command(1), payload)
        ask(keys.leg_command(2), {**LEG, "source": "anna"})
        client.session.put(keys.leg_command(2), json.dumps({**SET, "source": "bert"}))
        wait_for("source_changed", "event")
        for _ in range(MOST_BURSTS):
            if any('"overflow"' in line for line in heard["event"]):
                break
            ask(keys.leg_command(2), LEG)
            for _ in range(BURST):
                client.session.put(keys.leg_command(2), json.dumps(SET))
        wait_for('"overflow"', "event")
        ask(keys.ESTOP, {})
        ask(keys.leg_command(1), LEG)
        ask(keys.RESET, {})
        lease("challenge")
        anna = lease("acquire", "anna")
        lease("renew", lease=anna)
        ask(keys.leg_command(1), LEG)
        lease("ask", "bert")
        lease("release", lease=anna, to="bert")
        lease("acquire", "carl")
        lease("acquire", "bert")
        carl = lease("take", "carl")
        lease("renew", lease=anna)
        wait_for('"holder":"carl"', "state")
        wait_for("lease_expired", "event")
        lease("release", lease=carl)
        lease("release", lease=lease("acquire", "anna"))
        button("challenge")
        kitchen = button("register", "kitchen")
        button("alive", button=kitchen, count=1)
        button("alive", button=kitchen, count=1)
        wait_for('"names":["kitchen"]', "state")
        wait_for("button_silent", "event")
        button("alive", button=kitchen, count=2)
        button("leave", button=kitchen)
        button("leave", button=kitchen)
        wait_for("button_left", "event")
        gateway.child.send_signal(signal.SIGTERM)
        wait_for("stopping", "event")
        for subscriber in subscribers:
            subscriber.undeclare()
    heard["config"].append(_configuration_with_a_list())
    folder.mkdir(parents=True, exist_ok=True)
    for name, lines in heard.items():
        (folder / f"{name}.jsonl").write_text("\n".join(dict.fromkeys(lines)) + "\n")


def _configuration_with_a_list() -> str:
    """The configuration of a gateway with certificates, and a list of revoked ones."""
    with tempfile.TemporaryDirectory() as scratch:
        directory, port = Path(scratch) / "certs", free_port()
        certs.folder.init(directory, ["127.0.0.1"], port=port)
        certs.folder.issue(directory, "anna", "operator")
        certs.folder.revoke(directory, "operator-40")
        settings = {"zenoh": {"config": str(directory / "gateway.json5"), "listen": [f"tls/127.0.0.1:{port}"]}}
        with (
            Gateway(Path(scratch), settings),
            Client(None, zenoh_config=directory / "anna.json5", timeout_s=10) as client,
        ):
            client.state()
            (reply,) = client.session.get(keys.CONFIG, timeout=5)
            if reply.ok is None:
                raise RuntimeError("no configuration")
            return str(reply.ok.payload.to_string())


def _into(lines: list[str], changed: threading.Condition) -> Any:
    def take(sample: zenoh.Sample) -> None:
        with changed:
            lines.append(sample.payload.to_string())
            changed.notify_all()

    return take


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    os._exit(0)
