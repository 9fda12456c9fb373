"""What comes with a release: the SBOM (CycloneDX) from uv.lock, the SHA-256 of all files, and one signature.

ssh-keygen signs (Ed25519), which every robot has before any of our packages is there. `openssl` would do as well, but
ssh-keygen names what a signature is for (its namespace), and what key made it, and people know how to keep its keys.
"""

import datetime as dt
import hashlib
import json
import uuid
from collections.abc import Iterable
from pathlib import Path

from release.build import UV, run

EXTRAS = ("--extra", "spi", "--extra", "console", "--extra", "power")
"""The optional parts that a robot has."""
SUMS = "SHA256SUMS"
SIGNATURE = "SHA256SUMS.sig"
NAMESPACE = "hexapod-gateway-release"


def sbom(folder: Path, released: str, when: int) -> Path:
    """Write sbom.cdx.json, every package of a robot with its hashes. Raises SystemExit if the lock is old."""
    run([UV, "lock", "--check", "--no-config", "--default-index", "https://pypi.org/simple"])
    made = run([UV, "export", "--quiet", "--frozen", "--no-config", "--format", "cyclonedx1.5", *EXTRAS])
    path = folder / "sbom.cdx.json"
    path.write_text(_dated(made, released, when))
    return path


def _dated(made: bytes, released: str, when: int) -> str:
    """Return uv's SBOM with the release's version and time, and a serial number that follows from its content."""
    found = json.loads(made)
    found["metadata"]["timestamp"] = f"{dt.datetime.fromtimestamp(when, dt.UTC):%Y-%m-%dT%H:%M:%SZ}"
    found["metadata"]["component"] |= {"version": released, "purl": f"pkg:pypi/hexapod-gateway@{released}"}
    del found["serialNumber"]
    found["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(found, sort_keys=True)).urn
    return json.dumps(found, indent=2) + "\n"


def write_sums(folder: Path, paths: Iterable[Path]) -> None:
    """Write SHA256SUMS of these files of the folder, as `sha256sum --check` reads it."""
    lines = (f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(paths))
    (folder / SUMS).write_text("".join(lines))


def sign(folder: Path, key: Path) -> None:
    """Sign SHA256SUMS: SHA256SUMS.sig, in the same folder."""
    (folder / SIGNATURE).unlink(missing_ok=True)
    run(["ssh-keygen", "-q", "-Y", "sign", "-f", str(key.absolute()), "-n", NAMESPACE, str((folder / SUMS).absolute())])
