"""How a program's client finds its gateway, and lets go of it."""

import math
import os
import re
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

from gateway import certs
from gateway.client import Client, leg_payload
from gateway.errors import ConfigError, ZenohError
from schemas import keys
from tests.support.child import Child
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway, free_port

FORGETFUL = """
from gateway.client import Client
robot = Client({endpoint!r})
heard = [robot.on_state(lambda state: None), robot.on_event(print)]
print(robot.start_leg(3, 90, 45, 120).accepted)
"""

gateway = gateway_fixture()


def zenoh_file(path: Path, endpoint: str) -> Path:
    path.write_text(f'{{ mode: "client", connect: {{ endpoints: ["{endpoint}"] }} }}')
    return path


def test_the_file_says_where_unless_an_endpoint_is_given(gateway: Gateway, tmp_path: Path) -> None:
    right = zenoh_file(tmp_path / "right.json5", gateway.endpoint)
    wrong = zenoh_file(tmp_path / "wrong.json5", f"tcp/127.0.0.1:{free_port()}")
    for file in (right, str(right)):
        with Client(zenoh_config=file) as client:
            assert client.state().mode == "idle"
    with Client(gateway.endpoint, zenoh_config=wrong) as client:
        assert client.state().mode == "idle"
    with pytest.raises(ZenohError, match="no gateway answers"):
        Client(zenoh_config=wrong, timeout_s=0.3)


def test_with_neither_it_is_this_machines(gateway: Gateway, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.zenoh_config.DEFAULT_ENDPOINT", gateway.endpoint)
    for client in (Client(), Client(None)):
        with client:
            assert client.state().mode == "idle"


def test_a_file_that_names_no_gateway_is_reported(tmp_path: Path) -> None:
    (tmp_path / "empty.json5").write_text("{}")
    with pytest.raises(ConfigError, match=r"empty\.json5 names no gateway"):
        Client(zenoh_config=tmp_path / "empty.json5")


@pytest.mark.parametrize(
    ("endpoint", "options", "sentence"),
    [
        (None, {"source": ""}, "a source has 1 to 64 characters, and this one has 0"),
        (None, {"source": "x" * 65}, "a source has 1 to 64 characters, and this one has 65"),
        (None, {"timeout_s": 0}, "a timeout of 0 s will not do"),
        (None, {"timeout_s": -1}, "a timeout of -1 s will not do"),
        (None, {"timeout_s": math.nan}, "a timeout of nan s will not do"),
        (None, {"timeout_s": math.inf}, "a timeout of inf s will not do"),
        ("", {}, '"tcp/" is no endpoint, such as tcp/127.0.0.1:7447$'),
    ],
)
def test_what_makes_no_client_is_one_sentence_before_anybody_is_dialled(
    endpoint: str | None, options: dict[str, Any], sentence: str
) -> None:
    """A source that the gateway rejects would have every Stop rejected with it."""
    with pytest.raises(ConfigError, match=f"^{sentence}"):
        Client(endpoint, **options)


def test_the_lines_in_a_bundle_work(tmp_path: Path) -> None:
    port = free_port()
    folder, laptop = tmp_path / "D", tmp_path / "laptop"
    certs.folder.init(folder, ["127.0.0.1"], port=port)
    certs.folder.issue(folder, "anna", "operator", bundle=tmp_path / "anna.zip")
    with zipfile.ZipFile(tmp_path / "anna.zip") as archive:
        archive.extractall(laptop)
    found = re.search(r"In Python:\n\n((?:  .*\n)+)", (laptop / "README.txt").read_text())
    assert found
    code = re.sub("^  ", "", found[1], flags=re.MULTILINE).replace("path/to/", "laptop/")
    settings = {"zenoh": {"config": str(folder / "gateway.json5"), "listen": [f"tls/127.0.0.1:{port}"]}}
    with Gateway(tmp_path, settings):
        child = Child([sys.executable, "-c", code], os.environ, cwd=tmp_path)
        assert child.wait() == 0, child.stderr
        child.close()
    assert child.stdout == "idle\n"


def test_a_closed_client_says_so(gateway: Gateway) -> None:
    client = gateway.client()
    stream = client.stream()
    stream.open()
    stream.set({3: (90, 45, 120)})
    client.close()
    client.close()
    for call in (
        client.state,
        client.stop,
        client.estop,
        lambda: client.start_leg(3, 1, 2, 3),
        lambda: client.publish(keys.leg_command(3), leg_payload("stop")),
        lambda: client.on_state(print),
        lambda: stream.set({3: (90, 45, 120)}),
    ):
        with pytest.raises(ZenohError, match="this client is closed; make a new one"):
            call()


@pytest.mark.parametrize(("end", "status"), [("", 0), ("1 / 0", 1)])
def test_a_program_that_forgets_to_close_ends(gateway: Gateway, end: str, status: int) -> None:
    child = Child([sys.executable, "-c", FORGETFUL.format(endpoint=gateway.endpoint) + end], os.environ)
    assert child.wait(20) == status, child.stderr
    child.close()
    assert child.stdout.startswith("True\n")


def test_what_a_thread_still_does_comes_before_that_end(gateway: Gateway) -> None:
    later = """
import threading
def on():
    threading.main_thread().join()
    for _ in range(50):
        answer = robot.set_leg(3, 90, 45, 120)
    print("at last", answer.accepted)
threading.Thread(target=on).start()
"""
    child = Child([sys.executable, "-c", FORGETFUL.format(endpoint=gateway.endpoint) + later], os.environ)
    assert child.wait(20) == 0, child.stderr
    child.close()
    assert "at last" in child.stdout, "also where this machine was too slow for the watchdog"
