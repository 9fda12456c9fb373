"""The lines that a newcomer or a technician copies from the terminal, run as they are printed."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.client import Client
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.console_process import LINK
from tests.support.gateway_process import COMMAND, READY, free_port
from tests.support.heard import frames
from tests.support.pages import SCP, SSH, programs

REPOSITORY = Path(__file__).parents[2]
INSTALLER = REPOSITORY / "deploy" / "install.sh"


def script(path: Path, text: str) -> None:
    path.write_text(text)
    path.chmod(0o755)


@pytest.mark.parametrize("host", ["robot.local", "robot-2.local"])
def test_the_copy_lines_of_certs_bring_what_the_installer_asks_for(tmp_path: Path, host: str) -> None:
    """Those of `certs init` for the first robot, those of `certs issue --role robot` for another."""
    robot, folder = tmp_path / host, str(tmp_path / "certs")
    robot.mkdir()
    bin_folder = programs(tmp_path / "bin", ssh=SSH, scp=SCP)
    made = run_here("certs", "init", "--dir", folder, "--host", "robot.local").stdout
    if host != "robot.local":
        made = run_here("certs", "issue", "robot-2", "--role", "robot", "--host", host, "--dir", folder).stdout
    lines = [line for line in made.splitlines() if line.startswith("  ")]
    environment = {**os.environ, "PATH": f"{bin_folder}:{os.environ['PATH']}", "HOSTS": str(tmp_path)}
    subprocess.run(["sh", "-e", "-c", "\n".join(lines)], env=environment, check=True)
    wanted = next(line for line in INSTALLER.read_text().splitlines() if line.startswith("CERTIFICATES="))
    assert {path.name for path in (robot / "robot-certs").iterdir()} == set(wanted.split('"')[1].split())
    assert (robot / "robot-certs").stat().st_mode & 0o777 == 0o700


@pytest.mark.full
def test_an_unfit_virtual_environment_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "Makefile").write_text((REPOSITORY / "Makefile").read_text())
    (tmp_path / "pyproject.toml").touch()
    unfit = tmp_path / ".venv" / "bin" / "python"
    unfit.parent.mkdir(parents=True)
    (tmp_path / ".venv" / "run").touch()
    for answer in ("echo False", "exit 127"):  # too old; its Python has gone
        script(unfit, f"#!/bin/sh\n{answer}\n")
        planned = subprocess.run(["make", "-n", ".venv/run"], cwd=tmp_path, check=True, capture_output=True, text=True)
        assert "-m venv --clear .venv" in planned.stdout
        assert "pip install" in planned.stdout
    subprocess.run(["make", ".venv/bin/python"], cwd=tmp_path, check=True, capture_output=True)
    subprocess.run([unfit, "-c", "import sys; assert sys.version_info >= (3, 11)"], check=True)
    planned = subprocess.run(["make", "-n", ".venv/run"], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert "venv --clear" not in planned.stdout
    assert "pip install" in planned.stdout


@pytest.mark.full
def test_a_type_checker_finds_the_types_from_any_folder(tmp_path: Path) -> None:
    """Installed as `make` installs them, but without what they need."""
    clone, bin_folder = tmp_path / "clone", tmp_path / "venv" / "bin"
    for name in ("gateway", "schemas"):
        shutil.copytree(REPOSITORY / name, clone / name)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, clone)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    install = next(line for line in (REPOSITORY / "Makefile").read_text().splitlines() if line.startswith("INSTALL = "))
    command = install.removeprefix("INSTALL = ").replace("$(BIN)", str(bin_folder)).split()
    subprocess.run([*command, "--no-deps", "-e", clone], check=True)
    (tmp_path / "gait.py").write_text("from gateway.client import Ack\n\n\nreveal_type(Ack.or_raise)\n")
    mypy = [sys.executable, "-m", "mypy", "--python-executable", str(bin_folder / "python"), "gait.py"]
    checked = subprocess.run(mypy, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert 'gait.py:4: note: Revealed type is "def ' in checked.stdout, checked.stdout


@pytest.mark.parametrize("hides", ["schemas.py", "schemas/__init__.py"])
def test_a_file_that_hides_a_package_is_named(tmp_path: Path, hides: str) -> None:
    (tmp_path / hides).parent.mkdir(exist_ok=True)
    (tmp_path / hides).touch()
    command = [
        sys.executable,
        "-S",
        "-c",
        "from gateway.client import Client",
    ]  # -S: no import hooks
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    child = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert child.returncode == 1
    assert child.stderr.splitlines()[-1].endswith(f"{hides} hides the gateway's package of that name; rename it")


def test_the_first_incident_of_a_newcomer_is_kept_and_the_console_finds_a_port(tmp_path: Path) -> None:
    """`make run` with port 8080 taken; what it prints at last is where the console is."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    env = {**os.environ, "XDG_STATE_HOME": str(tmp_path), "HEXAPOD_ZENOH__LISTEN": f'["{endpoint}"]'}
    env.pop("STATE_DIRECTORY", None)
    start = ["make", "--old-file", f"{sys.prefix}/run", "run", f"VENV={sys.prefix}", f"CONSOLE=--connect {endpoint}"]
    with socket.socket() as other:
        with suppress(OSError):  # somebody else may have it already
            other.bind(("127.0.0.1", 8080))
            other.listen()
        child = Child(["setsid", *start], env, cwd=REPOSITORY)
        try:
            child.wait_for_output(READY, 30)
            address = child.wait_for_output(LINK, 30).removeprefix(LINK)
            port = int(address.removeprefix("http://127.0.0.1:").partition("/")[0])
            assert port > 8080
            child.wait_for_output(f"Port 8080 is taken by another program, so the console listens on {port}.")
            assert child.stdout.splitlines()[-1].startswith(LINK)
            with Client(endpoint, timeout_s=5) as client:
                seen = frames(client)
                assert client.start_leg(3, 90, 45, 120).accepted
                seen.wait(lambda frame: frame.cause == "watchdog")
            told = subprocess.run([*COMMAND, "check"], env=env, capture_output=True, text=True, check=True).stdout
            assert "runs on a simulated controller, and is " in told
            assert "ok       black box" in told
            assert not re.search("^(failure|warning  (frames|black box|SPI))", told, re.MULTILINE), told
            assert told.splitlines()[-1].startswith("The simulated robot is well")
            command = [*COMMAND, "incidents", "show", "last"]
            assert "leg 3" in subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGTERM)
            child.wait(20)
            child.close()
