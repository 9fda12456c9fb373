"""`hexapod/config` of a real gateway: published at the start, answered to a late reader, replaced by a restart."""

import json
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway.errors import DisconnectedError, UnansweredError
from gateway.people.client.lease_requests import Identity
from gateway.people.commands import why
from gateway.zenoh.config import client_config, open_session
from schemas import keys
from schemas.config import ConfigReport
from schemas.state import MAX_STATE_BYTES
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import Heard, states


def settings(port: int, timeout_ms: int) -> dict[str, Any]:
    servos = {f"servos.{leg}{joint}": {"max_speed_deg_s": 90} for leg in range(1, 6) for joint in range(1, 4)}
    return {
        "zenoh": {"listen": [f"tcp/127.0.0.1:{port}"]},
        "watchdog": {"timeout_ms": timeout_ms},
        **{f"limits.{name}": values for name, values in servos.items()},
    }


def test_a_late_reader_asks_for_the_configuration_and_a_small_one_receives_each_state(tmp_path: Path) -> None:
    """One that takes messages of 2048 bytes receives the state, but no larger message."""
    with Gateway(tmp_path, settings(free_port(), 250)) as gateway, gateway.client() as client:
        (state,) = (reply.ok.payload.to_bytes() for reply in client.session.get(keys.STATE) if reply.ok)
        (config,) = (reply.ok.payload.to_bytes() for reply in client.session.get(keys.CONFIG) if reply.ok)
        read = ConfigReport.model_validate_json(config)
        assert read.config == json.loads(state)["config"]
        assert (read.watchdog.timeout_ms, len(read.limits.servos), read.calibration.revision) == (250, 18, 0)
        assert client.state().limits == read.limits
        small = client_config(gateway.endpoint)
        small.insert_json5("transport/link/rx", json.dumps({"buffer_size": 2048, "max_message_size": 2048}))
        small.insert_json5("transport/link/tx/batch_size", "2048")
        with closing(open_session(small)) as reader:
            states_read = reader.declare_subscriber(keys.STATE, zenoh.handlers.FifoChannel(8))
            larger = reader.declare_subscriber(keys.FRAME, zenoh.handlers.FifoChannel(8))
            for _ in range(2):
                assert len(states_read.recv().payload) <= MAX_STATE_BYTES
            client.session.put(keys.FRAME, "large" * MAX_STATE_BYTES)
            assert states_read.recv()
            client.session.put(keys.FRAME, "small")
            assert larger.recv().payload.to_string() == "small"


def test_who_watches_while_the_gateway_restarts_with_other_settings_reads_them(tmp_path: Path) -> None:
    port = free_port()
    with Gateway(tmp_path, settings(port, 250)) as gateway:
        client = gateway.client()
    with client:
        with Gateway(tmp_path, settings(port, 250)):
            seen, published = states(client), Heard(client, keys.CONFIG, ConfigReport)
            assert seen.wait(lambda _: True).watchdog.timeout_ms == 250
        with Gateway(tmp_path, settings(port, 300)):
            seen.wait(lambda state: state.watchdog.timeout_ms == 300)
            assert client.state().watchdog.timeout_ms == 300
            assert len({each.config for each in published.all}) == len(published.all), "once, not with each state"


def test_made_up_states_and_answers_hide_no_state_and_ask_little(tmp_path: Path) -> None:
    """Without access control any program may publish and answer."""
    with (
        Gateway(tmp_path, settings(free_port(), 250)) as gateway,
        gateway.client() as client,
        closing(open_session(client_config(gateway.endpoint))) as stranger,
    ):
        state, config = (
            next(reply.ok.payload.to_string() for reply in client.session.get(key) if reply.ok)
            for key in (keys.STATE, keys.CONFIG)
        )
        named = json.loads(state)["config"]
        asked: list[str] = []  # the configuration that the client has at each question

        def answer(query: zenoh.Query) -> None:
            with query:
                asked.append(client.states.config.config if client.states.config else "")
                query.reply(keys.CONFIG, config.replace(named, "ffffffff").replace("250", "999"))

        seen = states(client)
        declared = stranger.declare_queryable(keys.CONFIG, answer)
        begun_s = time.monotonic()
        for count in range(1, 4):
            for _ in range(100):
                stranger.put(keys.STATE, state.replace(named, "00000000"))
            assert seen.wait(lambda _: True, count=10 * count).watchdog.timeout_ms == 250
        assert 0 < len(asked) <= 2 + (time.monotonic() - begun_s) / 0.2
        assert set(asked) == {named}, "another program's answer counts for nothing"
        assert {each.watchdog.timeout_ms for each in seen.all} == {250}
        declared.undeclare()


OLDER_RULES = """{access_control: {
  enabled: true, default_permission: "allow",
  rules: [{id: "new", permission: "deny", flows: ["ingress"], messages: ["query"], key_exprs: ["hexapod/config"]}],
  subjects: [{id: "all"}], policies: [{rules: ["new"], subjects: ["all"]}],
}}"""


def test_access_rules_without_the_configuration_are_named_and_stop_no_stop(tmp_path: Path) -> None:
    file = tmp_path / "older.json5"
    file.write_text(OLDER_RULES)
    older = {"zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"], "config": str(file)}}
    with Gateway(tmp_path, older) as gateway, gateway.client() as client:
        with pytest.raises(DisconnectedError, match=r"config is not: the access rules are of an older") as raised:
            client.state(0.5)
        assert not isinstance(raised.value, UnansweredError), "a gateway has answered"
        (finding,) = why.allowed(client, Identity.of(client_config(gateway.endpoint)))
        assert finding.stage == "gateway"
        assert finding.fix == "on the robot, `sudo hexapod-gateway check` names their file"
        assert client.stop().accepted
        assert client.estop().stop_frames == 6
