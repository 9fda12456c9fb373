"""The metrics of a power board: what it feeds, and what each servo draws."""

from collections import Counter
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from gateway.robot.runtime.prometheus import powered
from schemas.telemetry import Kind, PowerReport, ServoTelemetry, Supply, Telemetry
from tests.support.metrics_page import described, documented
from tests.support.published import WALL

BOARD = PowerReport(interface="slcan", alive=True, supplied=(11, 63), confirmed=False, age_ms=40.0)
DRAWN = Telemetry(
    time=WALL,
    age_ms=3.0,
    servos={"11": ServoTelemetry(supplied=True, current_a=0.25), "12": ServoTelemetry(supplied=False)},
    supply=Supply(voltage_v=7.3, current_a=0.25),
)


class Board(Collector):
    """The metrics of one board."""

    def __init__(self, power: PowerReport, measured: Telemetry | None, *events: Kind) -> None:
        self._found = power, measured, Counter(events)

    def collect(self) -> Iterator[Metric]:
        yield from powered(*self._found)


def page(board: Board) -> str:
    registry = CollectorRegistry()
    registry.register(board)
    return generate_latest(registry).decode()


def test_the_page_of_a_robot_with_a_power_board_is_the_list_in_the_docs() -> None:
    assert described(page(Board(BOARD, DRAWN))) == documented("with a power board")
    before = described(page(Board(PowerReport(interface="slcan", alive=False), None)))
    assert {name for name, _, _ in before} == {name for name, _, _ in documented("with a power board")}
