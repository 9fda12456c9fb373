"""The simulated power board in its own process, by a real client: python-can over slcan on a pseudo terminal."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import can
import pytest
from can.interfaces.slcan import slcanBus

from gateway.model.power_board import CanFrame, set_supply
from gateway.onboard.simulation_process import BoardProcess
from schemas.robot import SERVO_IDS

MOST_S: Final = 10.0
"""Nothing here takes a tenth of it."""
OUTPUTS: Final = (63, *SERVO_IDS[:-1])
"""The servo on each output: another order than the servos' own."""


class Client:
    """A program on the bus."""

    def __init__(self, board: BoardProcess) -> None:
        self.board = board
        self.bus = slcanBus(board.channel, bitrate=1_000_000, sleep_after_open=0.0)

    def close(self) -> None:
        with suppress(can.CanError):  # it may be unplugged
            self.bus.shutdown()
        self.bus.serialPortOrig.close()

    def read_on(self) -> None:
        while True:
            self.bus.recv(0.1)

    def next(self) -> int:
        """The identifier of the next frame."""
        message = self.bus.recv(MOST_S)
        assert message is not None
        return message.arbitration_id

    def send(self, frame: CanFrame) -> None:
        self.bus.send(can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False))

    def until(self, identifier: int) -> bytes:
        """The data of the next frame with it."""
        deadline_s = time.monotonic() + MOST_S
        while time.monotonic() < deadline_s:
            message = self.bus.recv(0.1)
            if message is not None and message.arbitration_id == identifier:
                return bytes(message.data)
        raise AssertionError(f"no {identifier:02X}")

    def ask(self, identifier: int) -> bytes:
        self.send(CanFrame(identifier))
        return self.until(identifier + 1)

    def asked_until(self, identifier: int, ends: Callable[[bytes], bool]) -> bytes:
        """Ask again and again until the answer is that."""
        deadline_s = time.monotonic() + MOST_S
        while time.monotonic() < deadline_s:
            if ends(data := self.ask(identifier)):
                return data
        raise AssertionError(data.hex())

    def feed(self, mask: int) -> None:
        """These alone, confirmed."""
        self.send(set_supply(mask))
        assert self.until(0x6B) == mask.to_bytes(3, "big")


@pytest.fixture
def board() -> Iterator[BoardProcess]:
    with BoardProcess(OUTPUTS) as board:
        yield board


@pytest.fixture
def client(board: BoardProcess) -> Iterator[Client]:
    client = Client(board)
    yield client
    client.close()


def test_a_client_switches_servos_and_the_page_shows_them(client: Client) -> None:
    page = client.board.page
    assert page.fed == frozenset()
    client.feed(0b11)
    assert page.fed == frozenset((63, 11))
    page.write(11, 80.0)
    page.write(12, 80.0)
    assert page.read() == {**dict.fromkeys(SERVO_IDS), 11: 80.0}
    # 11 holds what it carries, 63 is sent nowhere, and 12 is not fed.
    assert client.asked_until(0x70, lambda data: data[2:4] == (200).to_bytes(2, "big")).hex() == "000800c80000"
    client.send(set_supply(0))
    assert client.ask(0x86) == bytes.fromhex("001e001e001e"), "a question behind the mask"
    assert page.fed == frozenset(), "off at once: the answer is still to come"
    assert client.until(0x6B) == bytes(3)


def test_the_adapter_goes_and_returns_under_the_same_path(client: Client) -> None:
    client.feed(0b10)
    client.board.tell(json.dumps({"unplug": True}))
    with pytest.raises(can.CanError):
        client.read_on()
    assert not Path(client.board.channel).exists()
    assert client.board.page.fed == frozenset((11,)), "the board holds what it was sent"
    client.board.tell(json.dumps({"plug": True}))
    deadline_s = time.monotonic() + MOST_S
    while not Path(client.board.channel).exists():
        assert time.monotonic() < deadline_s
    again = Client(client.board)
    again.feed(0)
    again.close()


def test_it_ends_with_its_gateway_and_leaves_nothing() -> None:
    with BoardProcess(OUTPUTS) as board:
        assert board.folder.exists()
    assert not board.folder.exists()
