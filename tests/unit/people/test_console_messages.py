"""What the console takes from a page: messages, and a guide's steps; what one unknown connection may cost."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, cast

import pytest
from pydantic import ValidationError

from gateway.files import durable
from gateway.model.calibration import CalibrationError, RobotCalibration, ServoMapping
from gateway.people.console.pages.page_calibration import Guide
from gateway.people.console.pages.page_messages import FROM_PAGE, CommandRequest
from gateway.people.console.server import listener
from gateway.people.console.server.auth import Auth
from gateway.people.console.server.listener import MAX_CONNECTIONS, HttpListener
from gateway.people.console.server.sessions import Sessions
from gateway.people.console.server.site import Site

SET = {"op": "set", "angle_deg": 90.5}
START = {"op": "start", "angle_deg": 90}
STOP = {"op": "stop"}
LEG = {"servos": [SET, START, STOP]}


def command(key: str, payload: Any, **more: Any) -> dict[str, Any]:
    return {"type": "command", "key": key, "payload": payload, "sent_ms": 12.5, **more}


@pytest.mark.parametrize(
    ("message", "only_stops"),
    [
        (command("hexapod/leg/3/cmd", LEG, id=1), False),
        (command("hexapod/leg/3/cmd", {"servos": [STOP, STOP, STOP]}), True),
        (command("hexapod/legs/cmd", {"legs": {"1": LEG, "6": LEG}}), False),
        (command("hexapod/legs/cmd", {"legs": {"1": {"servos": [STOP, STOP, STOP]}}}), True),
        (command("hexapod/servo/63/cmd", START), False),
        (command("hexapod/servo/63/cmd", STOP), True),
    ],
)
def test_commands(message: dict[str, Any], only_stops: bool) -> None:
    found = FROM_PAGE.validate_json(json.dumps(message))
    assert isinstance(found, CommandRequest)
    assert found.only_stops is only_stops
    assert json.loads(found.payload.model_dump_json(exclude_unset=True)) == message["payload"]


@pytest.mark.parametrize(
    "message",
    [
        {"type": "alive", "now_ms": 0.1},
        {"type": "stop_all", "id": 0},
        {"type": "reset", "id": 4, "estop": 7, "sent_ms": 12},
        {"type": "lease", "id": 4, "do": "acquire"},
        {"type": "lease", "id": 4, "do": "release", "to": "bert"},
        {"type": "link_for", "id": 3},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 1, "left_m_s": 1, "gait": "wave"},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 1, "height_m": 0.1, "sits": True},
        {"type": "calibrate", "id": 5, "do": "test", "servo": 32, "deg": 90},
        {"type": "calibrate", "id": 5, "do": "jog", "deg": -0.1},
    ],
)
def test_the_others(message: dict[str, Any]) -> None:
    FROM_PAGE.validate_json(json.dumps(message))


@pytest.mark.parametrize(
    "message",
    [
        [],
        {"type": "shutdown"},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 12.5, "forward_m_s": 1.1},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 12.5, "gait": "gallop"},
        {"type": "walk", "id": 9, "press": 3, "sent_ms": 12.5, "height_m": 0},
        {"type": "calibrate", "id": 5, "do": "jog", "deg": 1e9},
        {"type": "calibrate", "id": 5, "do": "test", "deg": 90},
        {"type": "calibrate", "id": 5, "do": "undo", "servo": 32},
        {"type": "alive", "now_ms": -1},
        {"type": "stop_all", "id": 2**60},
        {"type": "stop_all", "id": 1, "please": True},
        {"type": "reset", "id": 4, "sent_ms": 12},
        {"type": "lease", "id": 4, "do": "challenge"},
        {"type": "lease", "id": 4, "do": "acquire", "to": "bert"},
        {"type": "lease", "id": 4, "do": "release", "to": ""},
        command("hexapod/leg/3/cmd", START),
        command("hexapod/leg/7/cmd", LEG),
        command("hexapod/servo/11/cmd", {"op": "set", "angle_deg": 181}),
        command("hexapod/servo/11/cmd", {**STOP, "source": "somebody else"}),
        command("hexapod/estop/cmd", {}),
        command("hexapod/state", STOP),
        command("hexapod/legs/cmd", {"legs": {}}),
        command("hexapod/leg/3/cmd", LEG, id="1"),
        {key: value for key, value in command("hexapod/leg/3/cmd", LEG).items() if key != "sent_ms"},
    ],
)
def test_what_ends_the_websocket(message: Any) -> None:
    with pytest.raises(ValidationError):
        FROM_PAGE.validate_json(json.dumps(message))


URL = "http://127.0.0.1:8080"


class Stand:
    """A front on a port of its own."""

    def __init__(self, folder: Path, listening: socket.socket) -> None:
        self.sessions = sessions = Sessions(folder, 8080)
        sessions.begin(f"{URL}/?token=", "operator")
        found = sessions.exchange(sessions.new_link().partition("token=")[2])
        assert found is not None
        self.cookie = f"Cookie: hexapod-console-8080={found[0]}\r\n"
        self.address = listening.getsockname()
        auth = Auth(Site("127.0.0.1", 8080, ("127.0.0.1",)), sessions)
        self.listener = HttpListener(None, auth.answer, cast(Any, None))

    async def ask(self, request: str) -> bytes:
        reader, writer = await asyncio.open_connection(*self.address[:2])
        writer.write(request.encode())
        answer = await reader.read()
        writer.close()
        return answer


@pytest.fixture
async def stand(tmp_path: Path) -> AsyncIterator[Stand]:
    with socket.create_server(("127.0.0.1", 0), backlog=200) as taken:
        found = Stand(tmp_path, taken)
        serving = asyncio.create_task(found.listener.serve([taken]))
        yield found
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)


@pytest.mark.full
@pytest.mark.parametrize(
    "request_text",
    [
        "POST / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nTransfer-Encoding: chunked\r\n\r\n1\r\nx\r\n",
        "GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nContent-Length: 5\r\n\r\nabcde",
        "GET / HTTP/1.1\r\nX: " + "y" * 40_000,
        "GET / HTTP/1.1\r\n" + "X: y\r\n" * 4000,
        "\x16\x03\x01 hello",
        "GET / HTTP/9\r\n\r\n",
        "BREW / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n",
    ],
    ids=["chunked", "body", "long line", "many lines", "tls", "version", "method"],
)
async def test_what_no_page_sends_ends_the_connection(stand: Stand, request_text: str) -> None:
    try:
        answer = await stand.ask(request_text)
    except ConnectionError:
        return
    assert not answer or answer.split()[1] in (b"400", b"403", b"405", b"414", b"431")


@pytest.mark.full
async def test_a_deadline_for_all_of_it(stand: Stand, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener, "UNKNOWN_S", 0.1)
    async with asyncio.timeout(10):
        assert await stand.ask("GET / HTTP/1.1\r\n") == b""


@pytest.mark.full
async def test_a_sign_in_that_waits_for_the_disk_delays_nobody(stand: Stand) -> None:
    link = stand.sessions.new_link().removeprefix(URL)
    with durable.locked(stand.sessions.path):
        entering = asyncio.create_task(stand.ask(f"GET {link} HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n"))
        assert (await stand.ask("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n")).startswith(b"HTTP/1.1 403 ")
        assert not entering.done()
    assert (await entering).startswith(b"HTTP/1.1 303 ")


@pytest.mark.full
async def test_strangers_make_room_before_who_is_signed_in(stand: Stand) -> None:
    reader, writer = await asyncio.open_connection(*stand.address[:2])
    strangers: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
    for count in (MAX_CONNECTIONS, 0):
        writer.write(f"GET /stop.js HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n{stand.cookie}\r\n".encode())
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200 ")
        await reader.readexactly(int(head.lower().partition(b"content-length: ")[2].split()[0]))
        strangers += [await asyncio.open_connection(*stand.address[:2]) for _ in range(count)]
        assert await strangers[0][0].read() == b"", "the oldest stranger makes room for the newest"
    assert (await stand.ask("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n")).startswith(b"HTTP/1.1 403 ")
    assert [each.at_eof() for each, _ in strangers] == [True, True] + [False] * (MAX_CONNECTIONS - 2)
    for _, each in strangers:
        each.close()
    writer.close()


COARSE_CDEG = 100
FINE_CDEG = 10


def guide(servo: ServoMapping | None = None, start_deg: float = 90.0) -> Guide:
    made = Guide(RobotCalibration(servos={} if servo is None else {32: servo}))
    made.choose(32, start_deg)
    return made


@pytest.mark.parametrize(("trim_cdeg", "inverted"), [(0, False), (-2_00, False), (-2_00, True)])
def test_keys_move_over_angles_that_are_never_sent(trim_cdeg: int, inverted: bool) -> None:
    """It is the servo's own angle that is never sent; both ways, and by each key."""
    made = Guide(RobotCalibration(servos={32: ServoMapping(trim_cdeg, inverted)}), (1_00, 4_00))
    made.choose(32, 90)
    down = -1 if not inverted else 1
    made.wire_cdeg = 5_50
    for by_cdeg, wire_cdeg in (
        (COARSE_CDEG, 4_50),
        (COARSE_CDEG, 99),
        (FINE_CDEG, 89),
        (-FINE_CDEG, 99),
        (-FINE_CDEG, 4_00),
    ):
        made.jog(down * by_cdeg)
        assert made.wire_cdeg == wire_cdeg


def test_a_servo_that_turns_the_other_way() -> None:
    made = guide(start_deg=80.0)
    made.change("highest_here")
    made.change("wrong_way")
    assert made.shown_deg == 100.0
    made.jog(COARSE_CDEG)
    assert made.shown_deg == 101.0
    assert made.command_deg == 79.0
    made.change("stands_at", 100.0)
    assert made.draft[32] == ServoMapping(-1_00, inverted=True, min_cdeg=100_00, max_cdeg=180_00)


def test_a_highest_and_a_lowest_angle_are_set_and_the_lowest_is_not_above() -> None:
    made = guide()
    made.jog(FINE_CDEG)
    made.change("highest_here")
    made.jog(-40 * COARSE_CDEG)
    made.change("lowest_here")
    assert made.draft[32] == ServoMapping(min_cdeg=50_10, max_cdeg=90_10)
    made.jog(41 * COARSE_CDEG)
    with pytest.raises(CalibrationError, match="min_deg must not be larger"):
        made.change("lowest_here")
    assert made.draft[32] == ServoMapping(min_cdeg=50_10, max_cdeg=90_10)


def test_undo_goes_back_to_the_beginning_and_as_drawn_to_no_calibration() -> None:
    made = guide()
    made.change("stands_at", 95.0)
    made.change("wrong_way")
    assert made.changed == [32]
    assert made.undo() == 32
    assert made.draft[32] == ServoMapping(trim_cdeg=-5_00)
    assert made.undo() == 32
    assert made.undo() is None
    assert made.changed == []
    made = guide(ServoMapping(7_00, inverted=True))
    made.change("as_drawn")
    assert (made.draft[32], made.changed) == (ServoMapping(), [32])


def test_the_guide_never_leaves_what_the_gateway_accepts() -> None:
    made = guide(ServoMapping(max_cdeg=92_00))
    made.jog(2 * COARSE_CDEG)
    with pytest.raises(CalibrationError, match="calibrated to go from 0 to 92 degrees"):
        made.jog(FINE_CDEG)
    assert made.command_deg == 92.0
    with pytest.raises(CalibrationError, match="has no command for it"):
        guide(ServoMapping(20_00), 0.0).jog(-COARSE_CDEG)
    with pytest.raises(CalibrationError, match="cannot go further"):
        guide(start_deg=180.0).jog(FINE_CDEG)


def test_a_servo_that_is_none() -> None:
    with pytest.raises(CalibrationError, match="servo 34 does not exist"):
        guide().choose(34, 90)
    made = guide()
    made.servo_id = None
    with pytest.raises(CalibrationError, match="choose a servo first"):
        made.change("stands_at", 90)
