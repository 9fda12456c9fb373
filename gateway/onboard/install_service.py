"""`python -m gateway.onboard.install_service`: the installer of this package, for a machine without the repository.

It installs this very release: a wheel made of the files that are installed here, and its dependencies with the hashes
of the lock; or, with --bundle or --wheels, what these have.
"""

import base64
import hashlib
import subprocess
import sys
import tempfile
import zipfile
from importlib.metadata import Distribution, PackagePath, distribution
from pathlib import Path
from typing import Final

import gateway
from gateway.errors import ConfigError

INSTALLER: Final = Path(gateway.__file__).with_name("deploy") / "install.sh"
_SOURCES: Final = ("--bundle", "--wheels", "--uninstall", "--rollback", "-h", "--help")
_OF_THE_INSTALLATION: Final = ("INSTALLER", "RECORD", "REQUESTED", "direct_url.json")
"""Written by pip, and no part of a wheel."""


def install(arguments: list[str]) -> int:
    """Run the installer; its exit code. Raises ConfigError."""
    if not INSTALLER.exists():
        raise ConfigError(f"{INSTALLER} is missing: this package was built without it; use deploy/install.sh")
    installer = INSTALLER.resolve()
    with tempfile.TemporaryDirectory(prefix="hexapod-gateway.") as folder:
        given = list(arguments)
        if not (installer.parent.parent / "pyproject.toml").exists() and not any(each in _SOURCES for each in given):
            given += ["--own-wheel", str(own_wheel(Path(folder)))]
        return subprocess.run(["bash", str(installer), *given], check=False).returncode


def own_wheel(folder: Path) -> Path:
    """A wheel of what is installed here, in `folder`. Raises ConfigError where files of it are missing."""
    found = distribution("hexapod-gateway")
    members = [each for each in found.files or [] if _is_packed(each)]
    path = folder / f"hexapod_gateway-{found.version}-py3-none-any.whl"
    record = next((str(each.parent / "RECORD") for each in members if each.name == "WHEEL"), None)
    if record is None:
        raise ConfigError("this gateway was not installed from a wheel: use deploy/install.sh of its repository")
    lines = []
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for each in sorted(members):
            data = _content(found, each)
            packed.writestr(zipfile.ZipInfo(str(each)), data, zipfile.ZIP_DEFLATED)
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
            lines.append(f"{each},sha256={digest},{len(data)}\n")
        packed.writestr(zipfile.ZipInfo(record), "".join(lines) + f"{record},,\n")
    return path


def _is_packed(path: PackagePath) -> bool:
    return not (path.parts[0] == ".." or "__pycache__" in path.parts or path.name in _OF_THE_INSTALLATION)


def _content(found: Distribution, path: PackagePath) -> bytes:
    try:
        return Path(str(found.locate_file(path))).read_bytes()
    except OSError as error:
        raise ConfigError(
            f"{path}, a file of this package, cannot be read: {error.strerror}; install it anew"
        ) from error


if __name__ == "__main__":
    try:
        sys.exit(install(sys.argv[1:]))
    except ConfigError as error:
        sys.exit(f"hexapod-gateway: {error}")
