"""One incident of each kind, from the real service on the emulated device: readable, and the same as the wire.

As systemd runs it: with the service's runtime directory, and `stop-servos` after an end that was none.
"""

import errno
import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.model.framing import Framing
from schemas import keys
from tests.hil.bed import SpiTestbed, Transfer
from tests.hil.wire import LATE_S, START_3
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings
from tests.support.mcap_file import checked

pytestmark = pytest.mark.hil

BEFORE_NS = 9_900_000_000
"""An incident goes back by ten seconds."""

FAULTY = """
import sys
from gateway import cli
from gateway.robot.runtime import conductor
def broken(self, received, now_ns):
    raise RuntimeError("planted")
sound = conductor.Conductor._receive
conductor.Conductor._receive = lambda *given: (broken if "planted" in str(given[1].payload) else sound)(*given)
cli.main()
"""


def silence(_: Client, bed: SpiTestbed, __: Child) -> None:
    def stopped(seen: list[Transfer]) -> bool:
        starts = [index for index, each in enumerate(seen) if each.data.hex() == START_3]
        return bool(starts) and any(is_stop_of(3, each) for each in seen[starts[-1] :])

    bed.wait_for(stopped, LATE_S)


def estop(client: Client, _: SpiTestbed, __: Child) -> None:
    assert client.estop().accepted


def bus_fault(client: Client, bed: SpiTestbed, _: Child) -> None:
    bed.fail(errno.EIO, count=1)
    assert client.ask(keys.leg_command(3), {"servos": [{"op": "set", "angle_deg": 91}] * 3}).reason == "bus_fault"


def mistake(client: Client, _: SpiTestbed, gateway: Child) -> None:
    client.publish(keys.leg_command(3), {"servos": [], "source": "planted"})
    gateway.wait(LATE_S)


def crash(_: Client, __: SpiTestbed, gateway: Child) -> None:
    gateway.kill()


def is_stop_of(leg: int, transfer: Transfer) -> bool:
    data = transfer.data
    return len(data) == 14 and data[2] // 10 == leg and data[3] == data[7] == data[11] == 2


KINDS: dict[str, Callable[[Client, SpiTestbed, Child], None]] = {
    "watchdog": silence, "estop": estop, "bus-fault": bus_fault, "mistake": mistake, "crash": crash,
}  # fmt: skip


def test_one_of_each_kind(tmp_path: Path, spi_testbed: SpiTestbed, monkeypatch: pytest.MonkeyPatch) -> None:
    """Six gateways one after the other, on one ring: an end begins the next incident anew."""
    run_folder = tmp_path / "run"
    run_folder.mkdir()
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(run_folder))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = write_settings(
        tmp_path / "gateway.toml",
        {
            "zenoh": {"listen": [endpoint]},
            "spi": {"framing": Framing.LENGTH_PREFIXED},
            # A repeated Stop whose preamble met the planted fault would be tried nevertheless, and counts as failed.
            # And a busy machine must not stop the leg before the fault does.
            "watchdog": {"timeout_ms": 1000},
            "state": {"path": str(tmp_path / "box")},
        },
    )
    for happens in KINDS.values():
        run(spi_testbed, config, endpoint, happens)
    before_crash = frames_on(spi_testbed)
    stop = spi_testbed.spawn([*COMMAND, "stop-servos", "--config", str(config)])
    assert stop.wait(LATE_S) == 0, str(stop)
    by_stop_servos = len(frames_on(spi_testbed)) - len(before_crash)
    run(spi_testbed, config, endpoint, lambda *_: None)
    assert not (run_folder / "stop-servos").exists(), "the next start is told of its own"
    found = exported(spi_testbed, config, tmp_path)
    assert found.keys() == KINDS.keys()

    shown = " ".join(frames_in(found["crash"]))
    after = frames_on(spi_testbed)[len(before_crash) + by_stop_servos :]
    assert shown in " ".join(each.data.hex() for each in before_crash + after)
    # All five, or on a busy machine as many as come within the ten seconds before the last.
    since_ns = before_crash[-1].monotonic_ns - BEFORE_NS
    assert " ".join(each.data.hex() for each in before_crash if each.monotonic_ns > since_ns) in shown
    for kind, path in found.items():
        story = Child([*COMMAND, "incidents", "show", path.stem, "--config", str(config)], spi_testbed.environment)
        assert story.wait(30) == 0, str(story)
        assert story.stdout.startswith(f"{path.stem}: "), kind
        assert "last command of leg 3 (hil, start 90 45 120)" in story.stdout, kind
        if kind == "crash":
            told = (
                "ended without a word",
                "stop-servos has written a Stop to each of the six legs",
                "a gateway starts",
            )
            places = [story.stdout.rindex(text) for text in told]
            assert places == sorted(places), story.stdout
        story.close()


def exported(bed: SpiTestbed, config: Path, folder: Path) -> dict[str, Path]:
    """The file of each incident, by its kind."""
    listed = bed.spawn([*COMMAND, "incidents", "list", "--json", "--config", str(config)])
    assert listed.wait(60) == 0, str(listed)
    found = {}
    for name in (each["id"] for each in json.loads(listed.stdout)):
        found[name.split("-", 3)[-1]] = path = folder / f"{name}.mcap"
        export = bed.spawn([*COMMAND, "incidents", "export", name, str(path), "--config", str(config)])
        assert export.wait(60) == 0, str(export)
    return found


def run(bed: SpiTestbed, config: Path, endpoint: str, happens: Callable[[Client, SpiTestbed, Child], None]) -> None:
    """A gateway that moves a leg until it happens, and is then ended, if it still runs."""
    gateway = bed.spawn([sys.executable, "-c", FAULTY, "run", "--config", str(config)])
    gateway.wait_for_output(READY, LATE_S)
    with Client(endpoint, source="hil", timeout_s=5) as client:
        assert client.ask(keys.RESET, {"estop": client.state().estop}).accepted, "of the run before"
        assert client.start_leg(3, 90, 45, 120).accepted
        happens(client, bed, gateway)
    if gateway.returncode is None:
        gateway.send_signal(signal.SIGTERM)
    gateway.wait(LATE_S)
    gateway.close()


def frames_on(bed: SpiTestbed) -> list[Transfer]:
    """The frames that the controller got."""
    return [each for each in bed.transfers if each.delivered and len(each.data) == 14]


def frames_in(path: Path) -> list[str]:
    """Its frames; each of its messages holds to the schema that the file carries."""
    return [content["bytes"] for topic, content in checked(path) if topic == keys.FRAME]
