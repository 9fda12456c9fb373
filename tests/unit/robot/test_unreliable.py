"""A simulated device whose transfers fail by chance."""

import pytest

from gateway.errors import ConfigError, SpiError
from gateway.model.framing import Framing
from gateway.robot.spi.simulator import Faults, SimulatedController, UnreliableDevice, read


@pytest.mark.parametrize(
    ("text", "faults"),
    [("0.1", Faults(0.1, 200)), ("1:0", Faults(1, 0)), ("0.01:2000", Faults(0.01, 2000)), ("0:", Faults(0, 200))],
)
def test_it_is_a_chance_and_a_time(text: str, faults: Faults) -> None:
    assert read(text) == faults


@pytest.mark.parametrize("text", ["", "a", "1.1", "-0.1", "nan", "0.1:-1", "0.1:nan", "0.1:60001", "0.1:1:2"])
def test_anything_else_is_rejected_in_a_sentence(text: str) -> None:
    with pytest.raises(ConfigError, match="write a chance from 0 to 1"):
        read(text)


def test_a_share_of_the_transfers_fails() -> None:
    device = UnreliableDevice(SimulatedController(Framing.PLAIN), Faults(0.5, 0))
    device.transfer(((b"\0", 0),))
    failed = 0
    for _ in range(1000):
        try:
            device.transfer(((b"\0", 0),))
        except SpiError:
            failed += 1
    assert 400 < failed < 600
