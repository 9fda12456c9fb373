"""The metrics of a power board: what it feeds, and what each servo draws."""

from collections import Counter
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from gateway.robot.runtime.prometheus import powered
from schemas.robot import SERVO_IDS
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


def samples(board: Board) -> dict[str, float]:
    """By name and first label."""
    found = [sample for family in text_string_to_metric_families(page(board)) for sample in family.samples]
    return {" ".join((sample.name, *sample.labels.values())): sample.value for sample in found}


def test_the_page_of_a_robot_with_a_power_board_is_the_list_in_the_docs() -> None:
    assert described(page(Board(BOARD, DRAWN))) == documented("with a power board")
    before = described(page(Board(PowerReport(interface="slcan", alive=False), None)))
    assert {name for name, _, _ in before} == {name for name, _, _ in documented("with a power board")}


def test_what_it_feeds_and_what_each_servo_draws() -> None:
    found = samples(Board(BOARD, DRAWN, Kind.POWER_UNCONFIRMED, Kind.FALLEN))
    assert (found["hexapod_power_alive"], found["hexapod_power_confirmed"]) == (1, 0)
    assert found["hexapod_power_answer_age_seconds"] == 0.04
    assert [servo for servo in SERVO_IDS if found[f"hexapod_servo_supplied {servo}"]] == [11, 63]
    assert found["hexapod_servo_current_amperes 11"] == 0.25
    assert "hexapod_servo_current_amperes 12" not in found
    assert found["hexapod_supply_volts"] == 7.3
    changes = {name.split()[1]: count for name, count in found.items() if name.startswith("hexapod_power_changes")}
    assert changes["power_unconfirmed"] == 1
    assert sum(changes.values()) == 1
    assert len(changes) == 7
