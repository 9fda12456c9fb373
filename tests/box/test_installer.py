"""The installer, from end to end on a bare system in a box: what it rejects, what it writes, what it leaves alone."""

import re
from pathlib import Path

import pytest

from gateway import certs
from tests.box.box import PATH_INSIDE
from tests.box.installed import CONFIGURATION, INSTALLER, NAME, share
from tests.box.machine import CONFIG_TXT, DROP_IN, STOCK, Machine, Prepared

pytestmark = pytest.mark.systemd

WITHOUT_COMPILER = """
mkdir -p /run/small
for program in /usr/sbin/* /usr/bin/*; do ln -sf "$program" /run/small; done
rm -f /run/small/*gcc* /run/small/*g++* /run/small/cc /run/small/c[89]9* /run/small/clang* /run/small/tcc
"""
"""A PATH with all that this machine has, but no compiler."""


@pytest.mark.nightly
def test_rejections(bare: Machine) -> None:
    """One sentence each, and nothing half made."""
    box = bare.box
    assert bare.install(check=False, python="/nonexistent")[0].startswith("install.sh: /nonexistent is no Python")
    box.write("/usr/local/bin/python-old", "#!/bin/sh\ncase $2 in *version_info?:*) echo 3.9.2;; *) exit 1;; esac\n")
    box.write("/usr/local/bin/python-bare", '#!/bin/sh\ncase $2 in *venv*) exit 1;; esac\nexec /usr/bin/python3 "$@"\n')
    box.run("chmod", "+x", "/usr/local/bin/python-old", "/usr/local/bin/python-bare")
    said = bare.install(check=False, python="/usr/local/bin/python-old")
    assert said == [
        "install.sh: /usr/local/bin/python-old is 3.9.2, and the gateway needs 3.11; "
        "name a newer one: PYTHON=/usr/bin/python3.11"
    ]
    said = bare.install(check=False, python="/usr/local/bin/python-bare")
    assert said == ["install.sh: /usr/local/bin/python-bare has no venv module; apt-get install python3-venv"]
    readable = "/usr/local/bin/install.sh"  # the repository may lie where nobody may read
    box.run("install", "--mode=755", INSTALLER, readable)
    nobody = box.run("setpriv", "--reuid=65534", "--clear-groups", readable, check=False)
    assert (nobody.returncode, nobody.stderr) == (1, f"install.sh: needs root: sudo {readable}\n")
    assert "has no hexapod_gateway-*.whl" in bare.run("--wheels", "/opt", check=False)[0]
    assert "is no option" in bare.run("--frce", check=False)[0]
    assert "has no gateway.json5" in bare.install("--certs", "/opt", check=False)[0]

    box.write("/run/arm/uname", "#!/bin/sh\necho armv7l\n")
    box.run("chmod", "+x", "/run/arm/uname")
    wheels = ("--framing", "plain", "--wheels", bare.wheels)
    assert box.run("env", f"PATH=/run/arm:{PATH_INSIDE}", INSTALLER, *wheels, check=False).stderr.startswith(
        "install.sh: /usr/bin/python3.11 is of a 32-bit system (armv7l), for which PyPI has no wheels of cffi, lz4 and "
        "zstandard: take the 64-bit Raspberry Pi OS"
    )

    box.run("cp", "-r", bare.wheels, "/opt/incomplete")
    box.run("sh", "-c", "rm /opt/incomplete/typer-*")
    assert (
        "pip could not install hexapod-gateway (above is why); nothing else was changed"
        in (bare.run("--framing", "plain", "--wheels", "/opt/incomplete", check=False)[-1])
    )
    assert bare.traces() == []
    assert box.read(CONFIG_TXT) == STOCK


def test_life(machine: Machine, prepared: Prepared) -> None:
    """Dry run, install, service up, command accepted, install again, uninstall, install again, all in one life."""
    box, unit = machine.box, machine.unit
    assert prepared.before == ([], STOCK)
    assert prepared.said == prepared.promised
    assert box.read(CONFIG_TXT) == STOCK.replace("#dtparam=spi", "dtparam=spi")
    assert "not started: reboot, SPI comes with it, and so does the service" in prepared.said
    assert unit.systemctl("is-enabled").stdout == "enabled\n"
    modes = box.run("stat", "--format=%A %U:%G", f"/etc/{NAME}", CONFIGURATION).stdout.splitlines()
    assert modes == [f"drwxr-x--- root:{NAME}", f"-rw-r----- root:{NAME}"]
    assert set(box.run("id", "--groups", "--name", NAME).stdout.split()) == {NAME, "spi"}
    assert box.run("find", f"/opt/{NAME}", "!", "-user", "root").stdout == ""

    box.run("sh", "-c", f"echo '# mine' >>{CONFIGURATION}")
    machine.simulate()
    assert "accepted" in machine.send()

    running = unit.property("MainPID")
    again = machine.install()
    done = [line for line in again if not line.startswith("keep ")]  # then what to do next
    assert [line.split()[0] for line in done] == ["start", "Next:"], "what is kept goes through its trial again"
    assert f"keep {CONFIGURATION}, your configuration" in again
    assert unit.property("MainPID") == running, "nothing changed, so nothing was restarted"

    box.write(f"/etc/systemd/system/{NAME}.service", "# an older version's\n[Service]\nExecStart=/bin/false\n")
    assert "restart the service: all legs stop" in machine.install()
    assert unit.property("ActiveState") == "active"
    assert unit.property("MainPID") != running

    promised = machine.run("--dry-run", "--uninstall")
    assert machine.run("--uninstall") == promised
    assert machine.traces() == [f"/etc/{NAME}"]
    assert unit.property("ActiveState") == "inactive"
    assert box.read(CONFIGURATION).endswith("# mine\n")
    assert box.run("stat", "--format=%A %U:%G", CONFIGURATION).stdout == "-rw------- root:root\n"
    assert machine.run("--uninstall") == [
        f"keep /var/lib/{NAME}, your calibration, for root only",
        f"keep /etc/{NAME}, your configuration, for root only",
        f"keep {DROP_IN}, your change to the service",
        "SPI and the group spi stay as they are",
    ]


@pytest.mark.nightly
def test_without_a_compiler(bare: Machine) -> None:
    """A bundle without spidev, on a machine that could not compile it: the service runs, and nothing was compiled."""
    box = bare.box
    box.run("sh", "-c", WITHOUT_COMPILER)
    installer = ("env", "PATH=/run/small", INSTALLER, "--framing", "plain")
    box.run("sh", "-c", f"cp -r {bare.wheels} /opt/without && cd /opt/without && rm spidev-*")
    box.run("sed", "-i", "/^spidev==/d", "/opt/without/requirements.txt")
    said = box.run(*installer, "--wheels", "/opt/without", timeout_s=300).stdout
    assert "leave spidev out (/opt/without has none): the gateway makes the kernel's calls itself\n" in said
    assert box.run(f"/opt/{NAME}/venv/bin/python", "-c", "import spidev", check=False).returncode == 1
    bare.simulate()
    assert "accepted" in bare.send()
    own = box.run("sh", "-c", f"echo {bare.wheels}/hexapod_gateway-*.whl").stdout.strip()
    said = box.run(*installer, "--dry-run", "--force", "--own-wheel", own).stdout
    assert "leave spidev out (it would have to be compiled, and gcc is missing): the gateway makes" in said


@pytest.mark.nightly
def test_an_upgrade_that_does_not_start_leaves_the_old_one_running(machine: Machine) -> None:
    """Found out with a simulated controller, nothing is changed; found out by systemd, it goes back by itself."""
    box = machine.box
    machine.simulate()
    first = machine.venv()
    pid = machine.unit.property("MainPID")

    broken = machine.release("broken", "\nimport sys\nif 'run' in sys.argv: raise SystemExit(7)\n")
    said = machine.run("--wheels", broken, check=False)
    assert any("does not start (above is why); the service stays as it was" in line for line in said), said
    assert (machine.venv(), machine.unit.property("MainPID")) == (first, pid)

    under = "\nimport os, sys\nif 'run' in sys.argv and 'NOTIFY_SOCKET' in os.environ: raise SystemExit(7)\n"
    said = machine.run("--wheels", machine.release("under-systemd", under), check=False)
    assert said[-1].endswith(f"so {first} runs again: journalctl -u {NAME} says why"), said
    assert machine.venv() == first
    assert machine.unit.property("ActiveState") == "active"
    assert box.run("sh", "-c", f"ls -d /opt/{NAME}/venv-*").stdout == f"{first}\n", "the broken ones are gone"
    assert machine.run("--rollback", check=False) == ["install.sh: there is no release before this one to go back to"]


SERVO_RUNS = "install.sh: a servo runs, and a restart would stop it: stop the robot first, or add --force"


def test_an_upgrade_waits_for_the_robot_and_can_be_taken_back(machine: Machine, tmp_path: Path) -> None:
    """Nor do other certificates, a way back or an uninstallation let it fall, where only certificates may ask."""
    box = machine.box
    certs.folder.init(tmp_path / "own-certs", ["127.0.0.1"])
    certs.folder.issue(tmp_path / "own-certs", "bob", "operator")
    certs.folder.init(tmp_path / "other-certs", ["127.0.0.1"])
    own, other = share(box, tmp_path / "own-certs"), share(box, tmp_path / "other-certs")
    machine.install("--certs", own)
    machine.simulate()
    first = machine.venv()
    newer = machine.release("newer", "\n# newer\n")
    held = start_holding(machine, own)
    configuration = box.run("sha256sum", CONFIGURATION, f"/etc/{NAME}/zenoh/gateway.key").stdout
    running = machine.unit.property("MainPID")
    for attempt in (("--wheels", newer), ("--wheels", machine.wheels, "--certs", other), ("--uninstall",)):
        assert machine.run(*attempt, check=False)[-1] == SERVO_RUNS, attempt
    assert machine.venv() == first
    assert box.run("sha256sum", CONFIGURATION, f"/etc/{NAME}/zenoh/gateway.key").stdout == configuration
    assert machine.unit.property("MainPID") == running
    promised = machine.run("--dry-run", "--wheels", newer, "--force")
    assert machine.run("--wheels", newer, "--force") == promised
    (versions,) = (line for line in promised if line.startswith("from "))
    assert re.fullmatch(r"from 1\.\d+\.\d+\+g[0-9a-f]{7}\S* to 1\.\d+\.\d+\+g[0-9a-f]{7}\S*", versions), versions
    box.run("kill", held, check=False)
    second = machine.venv()
    assert second != first

    held = start_holding(machine, own)
    assert machine.run("--rollback", check=False)[-1] == SERVO_RUNS
    # A service that hangs does not say what runs, and so counts as one that holds a robot up.
    box.run("sh", "-c", f"printf '%020d 0\n' 1 >/run/stale && mount --bind /run/stale /run/{NAME}/servos")
    assert "does not say whether a servo runs" in machine.run("--rollback", check=False)[-1]
    box.run("umount", f"/run/{NAME}/servos")
    promised = machine.run("--dry-run", "--rollback", "--force")
    assert machine.run("--rollback", "--force") == promised
    box.run("kill", held, check=False)
    assert machine.venv() == first
    assert machine.unit.property("ActiveState") == "active"
    machine.run("--rollback", "--force")
    assert machine.venv() == second


def start_holding(machine: Machine, folder: str) -> str:
    """Hold leg 3 from now on, by a process of this number."""
    hold = f"{NAME} send leg 3 start 90 45 120 --hold 120 --zenoh-config {folder}/bob.json5"
    held = machine.box.run("sh", "-c", f"{hold} >/dev/null 2>&1 & echo $!").stdout.strip()
    machine.box.run("sh", "-c", f"until grep -q ' 1$' /run/{NAME}/servos; do sleep 0.05; done", timeout_s=20)
    return held


@pytest.mark.nightly
def test_an_installation_that_was_ended_is_noticed(machine: Machine) -> None:
    """Killed between the switch and the restart: run again, it restarts, and `check` says what runs until then."""
    box = machine.box
    machine.simulate()
    old = machine.unit.property("MainPID")
    newer = machine.release("newer", "\n# newer\n")
    box.write(
        "/run/kill/systemctl",
        '#!/bin/sh\ncase $1 in restart) kill -KILL $PPID; exit 1;; esac\nexec /bin/systemctl "$@"\n',
    )
    box.run("chmod", "+x", "/run/kill/systemctl")
    killed = box.run("env", f"PATH=/run/kill:{PATH_INSIDE}", INSTALLER, "--wheels", newer, check=False, timeout_s=300)
    assert killed.returncode != 0
    assert machine.unit.property("MainPID") == old
    said = box.run(NAME, "check", check=False).stdout
    assert "the service that runs is another release than the one installed" in said, said
    said = "\n".join(machine.run("--wheels", newer))
    assert "an installation ended before its restart: the service still runs what was there before" in said
    assert machine.unit.property("MainPID") != old
    assert "restart" not in "\n".join(machine.run("--wheels", newer))
    assert "is another release" not in box.run(NAME, "check", check=False).stdout

    # The same of what the service reads: only its start takes it up.
    old = machine.unit.property("MainPID")
    box.run("sed", "-i", "1i # an older version's", f"/etc/systemd/system/{NAME}.service")
    box.run("env", f"PATH=/run/kill:{PATH_INSIDE}", INSTALLER, "--wheels", newer, check=False, timeout_s=300)
    assert machine.unit.property("MainPID") == old
    assert any("an installation ended before its restart" in line for line in machine.run("--wheels", newer))
    assert machine.unit.property("MainPID") != old


@pytest.mark.nightly
def test_what_a_power_cut_has_emptied_is_made_anew(machine: Machine) -> None:
    """Files of the release, its mark, the configuration and the unit, in whatever combination."""
    box = machine.box
    first = machine.venv()
    unit = f"/etc/systemd/system/{NAME}.service"
    written = box.read(CONFIGURATION)
    box.run(
        "sh",
        "-c",
        f"find {first}/lib -name '*.py' | head -n 1000 | xargs truncate --size=0; : >{unit}; : >{CONFIGURATION}",
    )
    (said,) = machine.run("--wheels", machine.wheels, check=False)
    assert "which framing does the controller need?" in said
    said = "\n".join(machine.install())
    assert f"make anew what is in {first}: its files are not those that were installed" in said
    assert box.read(CONFIGURATION) == written
    assert f"write {unit}" in said
    machine.simulate()
    assert "accepted" in machine.send()
    assert not box.exists(first), "what was broken is gone"
    second = machine.venv()
    box.run("truncate", "--size=0", f"{second}/complete")  # as older installers made it, whatever was beside it
    assert any(line.startswith(f"make anew what is in {second}") for line in machine.install("--dry-run", "--force"))


@pytest.mark.nightly
def test_certificates(machine: Machine, tmp_path: Path) -> None:
    """Brought with --certs or by hand, the service's user can read them, and the service takes only certificates."""
    box = machine.box
    certs.folder.init(tmp_path / "certs", ["127.0.0.1"])
    certs.folder.issue(tmp_path / "certs", "alice", "operator")
    folder = share(box, tmp_path / "certs")
    said = machine.install("--certs", folder)
    setting = f'config = "/etc/{NAME}/zenoh/gateway.json5"'
    assert f"use the certificates: {setting} in {CONFIGURATION}" in said
    assert said[-3:] == [
        f"Next: sudo {NAME} check",
        f"Then where ca.key is: {NAME} certs issue NAME --role operator --dir DIR --bundle NAME.zip",
        f"Then on the laptop: {NAME} check --zenoh-config NAME.json5",
    ]
    assert box.read(CONFIGURATION).splitlines().count(setting) == 1
    assert box.run("stat", "--format=%A %U:%G", CONFIGURATION).stdout == f"-rw-r----- root:{NAME}\n"
    files = box.run("ls", "-l", f"/etc/{NAME}/zenoh").stdout
    assert "ca.key" not in files
    assert re.search(rf"^-rw-r----- 1 root {NAME} .* gateway.key$", files, re.MULTILINE), files

    # A configuration that names another file stays, and so it is said.
    box.write(CONFIGURATION, "spi.framing = 'plain'\n[zenoh]\nconfig = ''\n")
    said = machine.install("--certs", folder)
    assert said[-1] == f"To use the certificates, in {CONFIGURATION} under [zenoh]: {setting}"
    box.write(CONFIGURATION, f"spi.framing = 'plain'\n[zenoh]\n{setting}\n")
    box.run("install", "-m", "0600", f"{folder}/gateway.key", f"/etc/{NAME}/zenoh/gateway.key")  # as by hand
    said = machine.install("--certs", folder)
    assert f"let {NAME} read all of /etc/{NAME}, and nobody else (root:{NAME})" in said
    assert f"keep /etc/{NAME}/zenoh/gateway.json5, your configuration" in said
    machine.simulate()
    command = (NAME, "send", "leg", "3", "stop")
    alice = box.run(*command, "--zenoh-config", f"{folder}/alice.json5")
    assert "accepted" in alice.stdout
    assert box.run(*command, "--timeout", "0.5", check=False).returncode == 4


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("before", "after"),
    [("[cm4]\notg_mode=1\n[all]\ndtparam=spi=on\n", None), ("dtparam=spi=off\n", "dtparam=spi=on\n")],
)
def test_config_txt(machine: Machine, before: str, after: str | None) -> None:
    """SPI is switched on where it is not; what counts as that is in test_config_txt.py."""
    machine.box.write(CONFIG_TXT, before)
    said = machine.install()
    assert (f"switch SPI on in {CONFIG_TXT} (dtparam=spi=on)" in said) == (after is not None)
    assert machine.box.read(CONFIG_TXT) == (before if after is None else after)


LENGTH_PREFIXED = ("--framing", "length-prefixed")


def test_no_framing_no_installation(bare: Machine) -> None:
    """Without a terminal somebody has to say it, and nothing is changed before; a dry run says the same."""
    for dry in ((), ("--dry-run",)):
        (said,) = bare.run("--wheels", bare.wheels, *dry, check=False)
        assert said.startswith("install.sh: which framing does the controller need? Say --framing: length-prefixed ")
    for wrong in (("--framing", "Plain"), ("--framing",)):
        (said,) = bare.run("--wheels", bare.wheels, *wrong, check=False)
        assert said.startswith("install.sh: --framing is length-prefixed (the published STM32 firmware) or plain")
    assert bare.traces() == []
    assert bare.box.read(CONFIG_TXT) == STOCK


@pytest.mark.nightly
def test_a_terminal_is_asked_and_the_framing_stays(machine: Machine) -> None:
    """Until it says one of the two. Installed again it needs no option, and another one is rejected at once."""
    wheels = ("--wheels", machine.wheels)
    machine.box.run("rm", "-r", f"/etc/{NAME}")
    asked = f"printf 'prefixed\nlength-prefixed\n' | script -qec '{INSTALLER} {' '.join(wheels)}' /dev/null"
    assert machine.box.run("sh", "-c", asked, timeout_s=300).stdout.count("length-prefixed or plain? ") == 2
    written = machine.box.read(CONFIGURATION)
    assert 'framing = "length-prefixed"' in written.splitlines()
    assert f"keep {CONFIGURATION}, your configuration" in machine.run(*wheels)
    assert f"keep {CONFIGURATION}, your configuration" in machine.run(*wheels, *LENGTH_PREFIXED)
    (said,) = machine.run(*wheels, "--framing", "plain", check=False)
    assert said.startswith(f'install.sh: {CONFIGURATION} says framing = "length-prefixed", and --framing plain; ')
    assert machine.box.read(CONFIGURATION) == written
