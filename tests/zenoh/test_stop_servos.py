"""`stop-servos` as a process: it loads little more than what writes the Stops."""

import subprocess
import sys
from pathlib import Path

SLOW = (
    "pydantic",
    "pydantic_core",
    "typer",
    "zenoh",
    "logging",
    "asyncio",
    "gateway.cli",
)


def test_nothing_slow_is_loaded_before_the_stops(tmp_path: Path) -> None:
    """Of the 0.33 s of processor time that it took with these, 0.07 s are left."""
    file = tmp_path / "gateway.toml"
    file.write_text('spi.framing = "plain"\nspi.device = "/dev/none"\n')
    program = (
        "import sys\nfrom gateway.__main__ import main\n"
        f"sys.argv = ['hexapod-gateway', 'stop-servos', '--config', {str(file)!r}]\n"
        "try:\n    main()\nfinally:\n"
        f"    print([name for name in {SLOW!r} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 3
    assert "/dev/none does not exist" in done.stderr
    assert done.stdout == "[]\n"


def test_nothing_slow_is_loaded_before_the_first_stops_of_the_service(tmp_path: Path) -> None:
    """Of the 0.40 s of processor time that they took with these, 0.09 s are left."""
    file = tmp_path / "gateway.toml"
    file.write_text('spi.framing = "plain"\nspi.device = "/dev/none"\n')
    program = (
        "import sys\nfrom gateway.robot.spi import stop_all\n"
        f"stop_all.stop_once = lambda bus: print([name for name in {SLOW!r} if name in sys.modules])\n"
        "from gateway.__main__ import main\n"
        f"sys.argv = ['hexapod-gateway', 'run', '--config', {str(file)!r}]\nmain()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 3
    assert done.stdout == "[]\n"


def test_the_service_loads_nothing_that_its_first_stops_do_not_need() -> None:
    """They would come that much later, after a crash as well."""
    late = {"rich", "textual", "prometheus_client", "gateway.simulation.controller", "gateway.simulation.elkapod"}
    loaded = "import sys, gateway.cli, gateway.onboard.serve, gateway.robot.service"
    program = f"{loaded}\nprint(*{late} & sys.modules.keys())"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.split() == []
