"""Install the robot's certificates from a folder or a zip of `certs issue`. They are checked before any change."""

import shutil
import tempfile
import zipfile
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.certs import access
from gateway.errors import ConfigError
from gateway.onboard.setup import configuration
from gateway.onboard.setup.configuration import Configuration
from gateway.onboard.setup.machine import ETC, Machine
from gateway.people.terminal import say

FOLDER: Final = f"{ETC}/zenoh"
CONFIG: Final = f"{FOLDER}/gateway.json5"
_MOST_BYTES: Final = 1_000_000
_ISSUE: Final = (
    "make them where ca.key is: hexapod-gateway certs issue NAME --role robot --host HOST --bundle NAME.zip --dir DIR"
)


def take(machine: Machine, source: Path, found: Configuration) -> Configuration:
    """Install the files of `source`, and name them in gateway.toml. Return the configuration. Raises ConfigError."""
    with tempfile.TemporaryDirectory() as unpacked:
        folder = source if source.is_dir() else Path(unpacked)
        if folder is not source:
            _unpack(source, folder)
        _check(folder, source)
        present = machine.read(CONFIG)
        keep = present is not None and not access.is_unedited(present)
        for name in (*certs.folder.ROBOT_FILES, certs.revocation.REVOCATION_FILE):
            if name == "gateway.json5" and keep:
                say(f"keep {CONFIG}, which somebody has edited")
            elif (folder / name).is_file() and not machine.put(f"{FOLDER}/{name}", (folder / name).read_bytes()):
                say(f"{FOLDER}/{name} is the same")
        if (folder / "ca.key").exists():
            say(f"{source} has ca.key, which can admit anybody: make sure another computer has it, and delete it here")
    stated = found.get("zenoh", "config")
    if stated == CONFIG:
        say(f"{configuration.FILE} names {CONFIG}")
    elif stated:
        say(f'keep zenoh.config = "{stated}" in {configuration.FILE}; to use the certificates, name {CONFIG} there')
    else:
        return configuration.write(machine, found, {"zenoh.config": CONFIG})
    return found


def refresh(machine: Machine) -> None:
    """Write this release's access rules to gateway.json5, if nobody has edited that file."""
    present = machine.read(CONFIG)
    if present is None or not access.is_unedited(present):
        return
    hosts = certs.folder.describe(machine.path(f"{FOLDER}/gateway.pem")).hosts
    made = access.gateway_json5(hosts, certs.folder.port_of(machine.path(CONFIG)))
    machine.put(CONFIG, made, f"write {CONFIG}: with this release's access rules")


def _unpack(archive: Path, folder: Path) -> None:
    """Extract all files into one folder, without their paths. Raises ConfigError."""
    try:
        with zipfile.ZipFile(archive) as packed:
            for member in packed.infolist():
                name = Path(member.filename).name
                if member.is_dir() or name.startswith("."):
                    continue
                if member.file_size > _MOST_BYTES:
                    raise ConfigError(f"{archive}: {name} is larger than any certificate")
                with packed.open(member) as inside, (folder / name).open("wb") as outside:
                    shutil.copyfileobj(inside, outside)
    except FileNotFoundError:
        raise ConfigError(f"there is no {archive}: {_ISSUE}") from None
    except OSError as error:
        raise ConfigError(f"cannot read {archive}: {error.strerror}") from error
    except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError) as error:
        raise ConfigError(f"{archive} is neither a folder nor a zip of `certs issue`: {error}; {_ISSUE}") from error


def _check(folder: Path, source: Path) -> None:
    """Raise ConfigError unless these are a robot's files that belong together."""
    if missing := [name for name in certs.folder.ROBOT_FILES if not (folder / name).is_file()]:
        raise ConfigError(f"{source} has no {' and no '.join(missing)}. A robot needs its own files: {_ISSUE}")
    if fault := certs.folder.mismatch(*(folder / name for name in ("ca.pem", "gateway.pem", "gateway.key"))):
        raise ConfigError(
            f"{fault.replace(str(folder), str(source))}: copy all files of the robot from one folder, or {_ISSUE}"
        )
    certs.folder.port_of(folder / "gateway.json5")
