"""What Linux says of the computer and the SPI controller, and how often systemd begins the service again."""

import re
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gateway.errors import SpiError
from gateway.onboard import computer, serve
from gateway.onboard.serve import PAUSE_S
from gateway.robot import service, settings
from tests.support.machine_tree import OF_MAY, PI_4, MachineTree

SPIDEV = "/dev/spidev0.0"


@pytest.mark.parametrize(("cells", "is_gpio"), [((7, 8, 1), True), ((0, 7, 7, 1), False), ((), False)])
def test_a_chip_select_of_the_controller_itself_is_no_gpio(
    cells: tuple[int, ...], is_gpio: bool, tmp_path: Path
) -> None:
    MachineTree(tmp_path, cs_gpios=struct.pack(f">{len(cells)}I", *cells))
    assert computer.gpio_selects(SPIDEV, tmp_path) is is_gpio


BUILT = {
    PI_4 + OF_MAY: "2024-05-29",
    "Linux version 6.12.25 (x) (gcc) #1 SMP PREEMPT Debian 1:6.12.25-1+rpt1 (2025-04-30)\n": "2025-04-30",
    "Linux version 6.6.45 (a@b) (gcc (2020-01-01)) #11 SMP Sat Aug 31 13:38:16 BST 2024\n": "2024-08-31",
    "Linux version 6.11.0 (b@c) (gcc) #8-Ubuntu SMP PREEMPT_DYNAMIC Thu Feb  6 10:11:12 UTC 2025\n": "2025-02-06",
    "Linux version 6.1.0 (a@b) (gcc (2020-01-01)) #1 SMP PREEMPT\n": "None",
    "Linux version 6.1.0 (a@b) #1 SMP Fri Feb 30 10:11:12 UTC 2024\n": "None",
}


@pytest.mark.parametrize("version", BUILT)
def test_the_build_date_of_a_kernel_is_read(tmp_path: Path, version: str) -> None:
    """The date of its compiler is not taken for it."""
    MachineTree(tmp_path, version=version)
    assert str(computer.kernel(tmp_path)[1]) == BUILT[version]


@pytest.mark.parametrize(
    ("model", "is_one"),
    [("Raspberry Pi 5 Model B", True), ("Raspberry Pi Compute Module 5", True), ("Raspberry Pi 4 Model B", False)],
)
def test_a_pi_5_is_known_by_its_name(model: str, is_one: bool, tmp_path: Path) -> None:
    MachineTree(tmp_path, model=model)
    assert computer.is_pi_5(tmp_path) is is_one


UNIT = (Path(__file__).parents[3] / "deploy/systemd/hexapod-gateway.service").read_text()
CRASHES_S = 5
"""A start on a Raspberry Pi 4, until it is killed."""


def setting(name: str) -> int:
    found = re.search(rf"^{name}=(\d+)$", UNIT, re.MULTILINE)
    assert found is not None
    return int(found[1])


def test_pauses_keep_starts_under_the_units_limit_and_crashes_reach_it() -> None:
    limit_s, burst, restart_s = (setting(each) for each in ("StartLimitIntervalSec", "StartLimitBurst", "RestartSec"))
    assert (PAUSE_S + restart_s) * burst > limit_s
    assert (CRASHES_S + restart_s) * burst < limit_s
    assert setting("TimeoutStartSec") > PAUSE_S


@pytest.mark.parametrize("simulated", [False, True])
def test_during_a_pause_a_real_robot_gets_stops(monkeypatch: pytest.MonkeyPatch, simulated: bool) -> None:
    """The device may return, and servos may run since a bus fault before the start."""
    stopped, pauses_s, used = list[Any](), list[float](), settings.Settings()
    monkeypatch.setattr("os.environ", {"NOTIFY_SOCKET": "@systemd", "WATCHDOG_USEC": "1000000"})
    monkeypatch.setattr(settings, "load", lambda *_, **__: used)
    monkeypatch.setattr(service, "run", lambda *_: (_ for _ in ()).throw(SpiError("told to fail")))
    monkeypatch.setattr(serve, "stop_before_service", lambda *of: stopped.append(of))
    monkeypatch.setattr(serve, "time", SimpleNamespace(monotonic=lambda: sum(pauses_s), sleep=pauses_s.append))
    with pytest.raises(SystemExit) as ended:
        serve.serve(None, simulated=simulated)
    assert (ended.value.code, round(sum(pauses_s))) == (SpiError.exit_code, PAUSE_S)
    assert stopped == ([] if simulated else [(used.wire, used.spi, used.controller)] * len(pauses_s))
