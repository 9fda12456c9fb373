"""The service unit under a real systemd: it starts, is watched, is stopped from outside after every end, gives up."""

import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.model.frames import Op, decode, stop_leg
from gateway.people.incidents.find import kind_of
from gateway.people.incidents.story import story
from schemas import keys
from tests.box.box import Unit
from tests.box.installed import CONFIGURATION, NAME, PYTHON, REPOSITORY, STOPS, InstalledGateway, wait_for_stops
from tests.hil.bed import SYSTEM_PYTHON
from tests.support.child import Child
from tests.support.recordings import checked, read

pytestmark = pytest.mark.systemd

KINDS = {"watchdog", "estop", "crash"}
UNIT = REPOSITORY / "deploy/systemd/hexapod-gateway.service"
MOVE_LEG_3 = ("send", "leg", "3", "start", "90", "45", "120")


def has_started(data: bytes) -> bool:
    """Return whether the frame energises a servo."""
    return any(command.op is Op.START for _, command in decode(data).servos)


def hold_for_a_moment(robot: InstalledGateway) -> None:
    """Hold leg 3 in motion; the client that does is killed."""
    before = len(robot.bed.transfers)
    with Child(robot.box.command(NAME, *MOVE_LEG_3, "--hold", "60"), {"PATH": "/usr/local/bin:/usr/bin"}):
        robot.bed.wait_for(lambda seen: any(has_started(each.data) for each in seen[before:]))


@pytest.mark.parametrize("unit", [UNIT, UNIT.with_name("hexapod-console.service")], ids=lambda unit: unit.stem)
def test_exposure(unit: Path) -> None:
    """`systemd-analyze security` counts at most 2.0."""
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=20", str(unit)]
    analysed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert analysed.returncode == 0, analysed.stdout


def test_sandbox(robot: InstalledGateway) -> None:
    """The running service: a user of its own, no privileges, a read-only system, no device but SPI."""
    cursor = robot.cursor()
    open_kmsg = ("/bin/sh", "-c", ": </dev/kmsg")
    robot.box.run(*open_kmsg)  # root may; root in the service's cgroup may not
    robot.drop_in("look", "ExecStartPre=+/bin/sh -c '/bin/sh -c \": </dev/kmsg\" 2>/run/kmsg; true'")
    robot.unit.systemctl("start")
    assert "Operation not permitted" in robot.box.read("/run/kmsg")

    pid = robot.unit.property("MainPID")
    status = dict(line.split(":\t", 1) for line in robot.box.read(f"/proc/{pid}/status").splitlines() if ":\t" in line)
    user = robot.box.run("id", "--user", NAME).stdout.strip()
    assert status["Uid"].split() == [user] * 4
    assert (status["NoNewPrivs"], status["CapBnd"], status["Seccomp"]) == ("1", "0" * 16, "2")
    assert str(512 * 2**20) in robot.box.run("grep", "Max data size", f"/proc/{pid}/limits").stdout

    inside = ("nsenter", f"--target={pid}", "--mount", "--")
    assert "Read-only file system" in robot.box.run(*inside, "touch", "/opt/x", check=False).stderr
    assert robot.box.run(*inside, "ls", "/root").stdout == ""

    policy = robot.box.run("chrt", "--pid", pid).stdout
    granted = "SCHED_FIFO" in policy  # where the kernel lets a control group have it
    said = f"real-time priority {'granted' if granted else 'not allowed'}"
    assert said in robot.journal_since(cursor), policy
    raised = robot.box.run("prlimit", "--nice=30:30", "--rtprio=20:20", "true", check=False).returncode == 0
    limits = [line.split()[-1] for line in robot.box.read(f"/proc/{pid}/limits").splitlines() if "priority" in line]
    assert limits == (["30", "20"] if raised else ["0", "0"]), "systemd gives what its own machine lets it"
    group = robot.box.run("cat", f"/proc/{pid}/autogroup", check=False).stdout
    assert not group or group.endswith(f"nice {-10 if raised else 0}\n"), "it goes ahead of other sessions"


@pytest.mark.nightly
def test_what_the_black_box_shows(robot: InstalledGateway) -> None:
    """The service's incidents, as the wire was."""
    robot.unit.systemctl("start")
    assert "accepted" in robot.gateway(*MOVE_LEG_3)
    moved = max(place for place, each in enumerate(robot.bed.transfers) if has_started(each.data))
    robot.bed.wait_for_data(stop_leg(3).data, since=moved)

    robot.configure("watchdog.timeout_ms = 10_000\n")  # else the watchdog is first each time
    restart_and_move(robot)
    robot.gateway("estop")
    robot.gateway("reset")

    restart_and_move(robot)
    with robot.journal() as service:
        robot.unit.systemctl("kill", "--signal=SIGKILL")
        service.wait_for_output("Stop written to all six legs, 4 times each")
        robot.unit.systemctl("stop")
        told = robot.gateway("incidents", "show", "last")
    assert "-crash: the gateway ended without a word" in told
    assert "last command of leg 3" in told
    found = {}
    for each in json.loads(robot.gateway("incidents", "list", "--json")):
        robot.gateway("incidents", "export", each["id"], f"/box-out/{each['id']}.mcap")
        found[kind_of(each["id"])] = robot.box.shared / f"{each['id']}.mcap"
    assert found.keys() >= KINDS
    on_wire = [each.data.hex() for each in robot.bed.transfers if each.delivered]
    for kind in KINDS:
        frames = [content["bytes"] for topic, content in checked(found[kind]) if topic == keys.FRAME]
        rest = iter(on_wire)
        assert all(frame in rest for frame in frames), f"{kind}: in the order of the wire"
        assert any(has_started(bytes.fromhex(frame)) for frame in frames), kind
        assert f"-{kind}: " in story(list(read(found[kind])))[0]


def restart_and_move(robot: InstalledGateway) -> None:
    robot.unit.systemctl("restart")
    assert "accepted" in robot.gateway(*MOVE_LEG_3)


CALIBRATE = """
from gateway.client import Client
from schemas.calibration import ServoChange
with Client() as robot:
    assert robot.calibrate({61: ServoChange(trim_deg=5)}).accepted
"""


@pytest.mark.nightly
def test_the_service_is_killed_and_its_stops_are_counted(robot: InstalledGateway) -> None:
    """`check --stops` kills it: Stops come from outside and at the new start, and nothing moves."""
    robot.unit.systemctl("start")
    robot.box.run(*PYTHON, CALIBRATE)
    before = robot.bed.transfers[-1].opening
    said = robot.gateway("check", "--stops", "--restart", "--yes", "--only", "restart", "--late", "70")
    assert "PASS     restart" in said
    assert robot.unit.properties("ActiveState", "NRestarts") == ["active", "1"]
    assert any(has_started(transfer.data) for transfer in robot.bed.transfers if transfer.opening == before)
    outside = [t.data for t in robot.bed.transfers if before < t.opening <= before + 4]  # stop-servos' four rounds
    assert len(outside) == 24
    assert set(outside) == STOPS
    assert {t.data for t in robot.bed.transfers if t.opening > before + 4} == STOPS, "and of the new start"
    shown = robot.gateway("calibrate", "export")
    robot.box.run("sh", "-c", f"rm /var/lib/{NAME}/calibration*")  # it is the service's own folder that keeps it
    assert '"revision": 1' in shown
    assert '"trim_deg": 5' in shown


def test_a_gateway_that_hangs_is_ended_and_its_servos_are_stopped(robot: InstalledGateway) -> None:
    """A transfer that never returns: killed by the watchdog with its stack in the journal, Stops, and a new start."""
    robot.unit.systemctl("start")
    opening = robot.bed.transfers[-1].opening
    with robot.journal() as journal:
        robot.bed.block()
        hung_ns = time.monotonic_ns()
        assert "accepted" not in robot.gateway(*MOVE_LEG_3, "--timeout", "0.1", check=False)
        journal.wait_for_output("Watchdog timeout")
        robot.bed.release()
        stops = wait_for_stops(robot.bed, opening=opening + 1)
        print(f"first Stop {(stops[0].monotonic_ns - hung_ns) / 1e6:.0f} ms after the hang")
        journal.wait_for_output("Fatal Python error: Aborted")
        journal.wait_for_output("in transfer")  # where it hung
        journal.wait_for_output("status=6/ABRT")
        journal.wait_for_output("Started ")
    assert robot.unit.properties("ActiveState", "NRestarts") == ["active", "1"]
    assert {transfer.data for transfer in robot.bed.transfers if transfer.opening > opening} == STOPS


def test_a_frozen_service_is_stopped_each_time(robot: InstalledGateway) -> None:
    """`systemctl freeze`, while a leg moves: what should stop it afterwards would be frozen, too."""
    for verb in ("start", "restart", "start"):
        robot.unit.systemctl(verb)
        hold_for_a_moment(robot)
        opening, cursor = robot.bed.transfers[-1].opening, robot.cursor()
        with robot.journal() as journal:
            frozen_ns = time.monotonic_ns()
            robot.unit.systemctl("freeze")
            stops = wait_for_stops(robot.bed, opening=opening + 1)
            print(f"first Stop {(stops[0].monotonic_ns - frozen_ns) / 1e6:.0f} ms after the freeze")
            journal.wait_for_output("Started")
        assert "timed out" not in robot.journal_since(cursor)


FILL = """
import ctypes, os, socket, sys
PIDFD_GETFD = 438  # a system call that Python does not know
stderr = ctypes.CDLL(None).syscall(PIDFD_GETFD, os.pidfd_open(int(sys.argv[1])), 2, 0)
with socket.socket(fileno=stderr) as journal:
    for size in (4096, 1):
        try:
            while True:
                journal.send(b"\\n" * size, socket.MSG_DONTWAIT)
        except BlockingIOError:
            pass
"""
"""Writes empty lines, which journald forgets, to another process's stderr, a socket, until that is full."""


@pytest.fixture
def stuck_journal(robot: InstalledGateway) -> Iterator[None]:
    """Run the service while the journal reads nothing of what it says."""
    robot.unit.systemctl("start")
    journald = Unit(robot.box, "systemd-journald.service")
    journald.systemctl("kill", "--signal=STOP")
    robot.box.run(SYSTEM_PYTHON, "-c", FILL, robot.unit.property("MainPID"))
    yield
    journald.systemctl("kill", "--signal=CONT")


@pytest.mark.usefixtures("stuck_journal")
def test_a_stuck_journal_holds_no_stop(robot: InstalledGateway) -> None:
    """Rejected commands are logged, and nobody reads that: the watchdog's Stop comes, and those of the end."""
    assert "accepted" in robot.gateway(*MOVE_LEG_3)
    assert "rejected" in robot.gateway("send", "leg", "1", "set", "1", "1", "1", check=False)
    moved = len(robot.bed.transfers)
    assert "accepted" in robot.gateway(*MOVE_LEG_3)
    opening = robot.bed.transfers[-1].opening
    stop_3 = robot.bed.wait_for_data(stop_leg(3).data, since=moved)
    assert stop_3.opening == opening, "from the service itself"
    before = len(robot.bed.transfers)
    robot.unit.systemctl("stop")
    for writer in (opening, opening + 1):  # the service, and then stop-servos
        assert {each.data for each in robot.bed.transfers[before:] if each.opening == writer} == STOPS
    assert robot.unit.properties("ActiveState", "Result", "ExecMainStatus") == ["inactive", "success", "0"]


def test_stop_servos_beside_the_service(robot: InstalledGateway) -> None:
    """Root and a member of the group spi run it beside the service, which then counts its servos as stopped."""
    robot.unit.systemctl("start")
    for user in ((), ("setpriv", "--reuid=65534", "--regid=spi", "--clear-groups")):
        hold_for_a_moment(robot)
        with robot.journal() as journal:
            robot.box.write("/box-out/stop.toml", 'spi.framing = "plain"\n')
            command = (f"/usr/bin/{NAME}", "stop-servos", "--config", "/box-out/stop.toml")
            said = robot.box.run(*user, "env", *robot.emulated, *command).stdout
            assert "The running gateway counts all servos as stopped" in said
            journal.wait_for_output("stop-servos stopped all servos past the gateway")
            journal.wait_for_output("lease_expired")  # of whoever held the leg, and was killed
        assert "rejected: servo_stopped" in robot.gateway("send", "leg", "3", "set", "1", "2", "3", check=False)


def test_a_service_that_never_had_the_device_leaves_the_robot_of_a_gateway_in_a_terminal(
    robot: InstalledGateway,
) -> None:
    """Each of its starts fails, and `stop-servos` then writes nothing; once the other gateway is killed, it does."""
    at = "tcp/127.0.0.1:7448"
    robot.box.write("/box-out/own.toml", f'spi.framing = "plain"\nzenoh.listen = ["{at}"]\n')
    path = {"PATH": "/usr/local/bin:/usr/bin"}
    own = robot.box.command("env", *robot.emulated, NAME, "run", "--config", "/box-out/own.toml")
    with Child(own, path) as gateway:
        gateway.wait_for_output("is ready")
        earlier = len(robot.bed.transfers)
        with Child(robot.box.command(NAME, *MOVE_LEG_3, "--hold", "100", "--connect", at), path):
            seen = robot.bed.wait_for(lambda seen: any(has_started(each.data) for each in seen[earlier:]))
            with robot.journal() as journal:
                robot.unit.systemctl("start", "--no-block")
                journal.wait_for_output("is held by another gateway")
                journal.wait_for_output("no Stop is written: another gateway holds the device")
            since = robot.bed.transfers[len(seen) :]
            assert {each.opening for each in since} == {seen[-1].opening}
            assert stop_leg(3).data not in {each.data for each in since}
            before = len(robot.bed.transfers)
            robot.box.run("pkill", "-KILL", "--full", "own.toml")
            wait_for_stops(robot.bed, since=before)


def test_first_stops_wait_for_no_disk_of_the_state(robot: InstalledGateway) -> None:
    """The documented recipe, with a disk that is missing: Stops come while the service waits for it; then it starts."""
    page = (REPOSITORY / "docs/robot.md").read_text().partition("## Keep the state over a boot")[2]
    lines = [line.removeprefix("$ sudo ") for line in page.split("```")[1].splitlines() if line.startswith("$ ")]
    recipe = "\n".join(line for line in lines if "fstab" not in line and "mount /srv" not in line)
    recipe = recipe.replace("\\n[Install]", f"\\nEnvironment={' '.join(robot.emulated)}\\n[Install]")
    units = "srv-hexapod.mount hexapod-stops hexapod-gateway"
    try:
        robot.configure('state.path = "/srv/hexapod"\n')
        # In a container systemd waits for no device, so a service that does not end is in its place.
        robot.box.write("/run/systemd/system/disk.service", "[Service]\nType=oneshot\nExecStart=/bin/sleep infinity\n")
        needs = "[Unit]\nRequires=disk.service\nAfter=disk.service\n"
        robot.box.write("/run/systemd/system/srv-hexapod.mount", f"{needs}[Mount]\nWhat=tmpfs\nWhere=/srv/hexapod\n")
        robot.box.run("bash", "-ec", recipe)
        before = len(robot.bed.transfers)
        robot.box.run("bash", "-ec", f"systemctl daemon-reload; systemctl start --no-block {units}")
        wait_for_stops(robot.bed, since=before)
        assert robot.unit.property("ActiveState") == "inactive"
        robot.box.run("systemctl", "kill", "disk.service")  # as when its time is over
        robot.unit.systemctl("start")
        assert "Emergency stop: nothing runs" in robot.gateway("status")
    finally:
        undo = "systemctl disable hexapod-stops; rm -r /etc/systemd/system/hexapod-gateway.service.d"
        undo += " /etc/systemd/system/hexapod-stops.service /run/systemd/system/srv-hexapod.mount"
        undo += " /run/systemd/system/disk.service; systemctl kill disk.service"
        robot.box.run("bash", "-c", f"systemctl cancel; {undo}; systemctl daemon-reload")


def test_no_framing(robot: InstalledGateway) -> None:
    """Neither the service nor stop-servos guesses: exit code 2, said twice in three lines, and nothing on the wire."""
    before = len(robot.bed.transfers)
    robot.box.write(CONFIGURATION, "")
    with robot.journal() as journal:
        robot.unit.systemctl("start", check=False)
        journal.wait_for_output("Failed to start")
        said = [line for line in journal.stdout.splitlines() if "spi.framing" in line]
    assert len(said) == 6
    assert robot.unit.properties("ActiveState", "ExecMainStatus", "NRestarts") == ["failed", "2", "0"]
    assert len(robot.bed.transfers) == before


def test_a_list_of_revoked_certificates_starts_it_anew_and_systemd_sees_no_end(robot: InstalledGateway) -> None:
    """The list comes over Zenoh. All legs stop, then the same process starts anew, also again, with its watchdog."""
    box, folder, own = robot.box, "/root/certs", "/etc/hexapod-gateway/zenoh"
    bert = ("--zenoh-config", f"{folder}/bert.json5")
    robot.gateway("certs", "init", "--dir", folder, "--host", "127.0.0.1")
    for name in ("anna", "bert", "carl"):
        robot.gateway("certs", "issue", name, "--role", "operator", "--dir", folder)
    box.run("sh", "-c", f"mkdir -p {own} && cd {folder} && cp ca.pem gateway.* {own} && chown -R root:{NAME} {own}")
    box.run("chmod", "-R", "u=rwX,g=rX,o=", own)
    robot.configure(f'zenoh.config = "{own}/gateway.json5"\nzenoh.listen = ["tls/127.0.0.1:7447"]\n')
    robot.unit.systemctl("start")
    pid, cursor = robot.unit.property("MainPID"), robot.cursor()
    assert "accepted" in robot.gateway(*MOVE_LEG_3, "--zenoh-config", f"{folder}/anna.json5")
    before = len(robot.bed.transfers)
    robot.gateway("certs", "revoke", "anna", "--dir", folder, "--to", "127.0.0.1", *bert)
    wait_for_stops(robot.bed, since=before)
    assert "accepted" in robot.gateway(*MOVE_LEG_3, *bert, "--timeout", "10")
    assert robot.unit.properties("MainPID", "NRestarts", "ActiveState") == [pid, "0", "active"]
    said = robot.journal_since(cursor)
    assert "list 1 shuts out operator-00" in said
    policy = box.run("chrt", "--all-tasks", "--pid", pid).stdout
    assert ("SCHED_FIFO" in policy) is ("real-time priority granted" in said)
    assert said.count("real-time priority granted") in (0, 1), "as at the first start, which came before"

    before = len(robot.bed.transfers)
    nowhere = ("--to", "tls/127.0.0.1:1")
    assert "Not confirmed by tls/127.0.0.1:1" in robot.gateway(
        "certs", "revoke", "carl", "--dir", folder, *nowhere, check=False
    )
    assert "list 2 is in force" in robot.gateway("certs", "revoke", "--dir", folder, "--to", "127.0.0.1", *bert)
    wait_for_stops(robot.bed, since=before)
    assert "accepted" in robot.gateway(*MOVE_LEG_3, *bert, "--timeout", "10")
    assert box.run("stat", "--format=%U", f"/var/lib/{NAME}/revoked.crl").stdout.strip() == NAME

    assert robot.unit.property("MainPID") == pid
    robot.gateway("certs", "revoke", "operator-40", "--dir", folder, "--to", "127.0.0.1", *bert)
    assert "accepted" in robot.gateway(*MOVE_LEG_3, *bert, "--timeout", "10")
    before = len(robot.bed.transfers)
    with robot.journal() as journal:
        box.run("kill", "-STOP", pid)
        wait_for_stops(robot.bed, since=before)
        journal.wait_for_output("Watchdog timeout (limit 1s)")
    box.run("sh", "-c", f"rm -rf {own} {folder} /var/lib/{NAME}/revoked*.crl")
