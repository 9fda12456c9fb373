"""Today's tools beside tomorrow's gateway: more fields, new words, and they go on working."""

import json
import os
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
import zenoh

from schemas import keys
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.gateway_process import COMMAND, free_port
from tests.unit.test_wire import WIRE, from_the_future

STATE = json.loads((WIRE / "1.0" / "state.jsonl").read_text().splitlines()[0])
EVENT = json.loads((WIRE / "1.0" / "event.jsonl").read_text().splitlines()[0])


class Tomorrow:
    """A gateway of a later version: it answers and publishes, and does nothing else."""

    def __init__(self) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("listen/endpoints", json.dumps([self.endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.mode = "hovering"
        self._declared: list[Any] = [
            self.session.declare_queryable(keys.STATE, lambda query: self._answer(query, keys.STATE, self.state)),
            self.session.declare_queryable(keys.ESTOP, self._estop),
            self.session.declare_queryable(keys.LEGS_COMMAND, self._reject),
            self.session.liveliness().declare_token(keys.ALIVE),
        ]

    @property
    def state(self) -> dict[str, Any]:
        return {**from_the_future(STATE), "mode": self.mode}

    def tell(self) -> None:
        """An event of a kind that nobody knows yet, and a state."""
        self.session.put(keys.EVENT, json.dumps({**from_the_future(EVENT), "kind": "lifted", "detail": "two hands"}))
        self.session.put(keys.STATE, json.dumps(self.state))

    def _estop(self, query: zenoh.Query) -> None:
        self.mode = "estopped"
        self._answer(
            query, keys.ESTOP, {"accepted": True, "stop_frames": 6, "latency_us": 900.0, "estop": 1, "by": "us"}
        )

    def _reject(self, query: zenoh.Query) -> None:
        ack = {"accepted": False, "reason": "too_windy", "detail": "the wind blows", "until": "tomorrow"}
        self._answer(query, keys.LEGS_COMMAND, ack)

    def _answer(self, query: zenoh.Query, key: str, payload: object) -> None:
        with query:
            query.reply(key, json.dumps(payload), encoding="application/json")

    def close(self) -> None:
        self.session.close()


@pytest.fixture
def tomorrow() -> Iterator[Tomorrow]:
    with closing(Tomorrow()) as gateway:
        yield gateway


def test_send_and_estop_show_answers_in_words_that_they_do_not_know(tomorrow: Tomorrow) -> None:
    sent = run_here("send", "stop", "--connect", tomorrow.endpoint)
    assert sent.returncode == 1
    assert "too_windy: the wind blows" in sent.stdout
    stopped = run_here("estop", "--connect", tomorrow.endpoint)
    assert stopped.returncode == 0
    assert stopped.stdout.startswith("stopped: 6 Stop frames")


def test_status_shows_new_words(tomorrow: Tomorrow) -> None:
    with Child([*COMMAND, "status", "--follow", "--connect", tomorrow.endpoint], os.environ) as child:
        child.wait_for_output("Nobody drives.")
        tomorrow.tell()
        assert "two hands" in child.wait_for_output("lifted")
