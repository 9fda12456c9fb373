"""Bundles of several releases and keys, made of one folder of wheels."""

import hashlib
import io
import shutil
import subprocess
import tarfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from release.build import build, plain_tar
from release.bundle import bundle

WHEN = 1_700_000_000


@dataclass
class Bundles:
    """Where they are made: `folder` has keys and bundles, `wheels` what `make wheels` made."""

    folder: Path
    wheels: Path

    def key(self, name: str) -> Path:
        """An Ed25519 key of that name, made where there is none yet."""
        path = self.folder / name
        if not path.exists():
            subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", path], check=True)
        return path

    def fingerprint(self, name: str) -> str:
        """As people compare it."""
        shown = subprocess.run(["ssh-keygen", "-lf", self.key(name)], capture_output=True, text=True, check=True)
        return shown.stdout.split()[1]

    def make(self, release: str, key: str) -> Path:
        """A bundle of that release, of the code as it is."""
        filled, to = self.folder / f"wheels-{release}", self.folder / f"{release}-{key}"
        if made := list(to.glob("*")):
            return made[0]
        if not filled.exists():
            shutil.copytree(self.wheels, filled)
            requirements = filled / "requirements.txt"
            others = [line for line in requirements.read_text().splitlines() if not line.startswith("hexapod_gateway")]
            for path in filled.glob("hexapod_gateway-*.whl"):
                path.unlink()
            wheel = build(to_folder(self.folder / f"built-{release}"), release, WHEN)[0]
            shutil.copy(wheel, filled)
            digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
            requirements.write_text("\n".join([*others, f"hexapod_gateway=={release} --hash=sha256:{digest}", ""]))
        return bundle(to_folder(to), filled, release, WHEN, self.key(key))

    def changed(self, whole: Path, name: str, change: Callable[[dict[str, bytes]], None]) -> Path:
        """A copy of a bundle with its members changed."""
        with tarfile.open(whole) as archive:
            members = {each.name: read(archive, each) for each in archive}
        change(members)
        path = self.folder / name
        path.write_bytes(plain_tar(members, WHEN))
        return path


def to_folder(path: Path) -> Path:
    path.mkdir(exist_ok=True)
    return path


def read(archive: tarfile.TarFile, entry: tarfile.TarInfo) -> bytes:
    content = archive.extractfile(entry)
    assert isinstance(content, io.BufferedReader | tarfile.ExFileObject)
    return content.read()
