"""The SBOM (CycloneDX) of a release, from uv.lock."""

import datetime as dt
import json
import uuid
from pathlib import Path

from release.build import UV, run

EXTRAS = ("--extra", "spi", "--extra", "console", "--extra", "power")
"""What a robot has."""


def sbom(folder: Path, released: str, when: int) -> Path:
    """sbom.cdx.json in `folder`: every package of a robot's, with its hashes. Raises SystemExit if the lock is old."""
    run([UV, "lock", "--check", "--no-config", "--default-index", "https://pypi.org/simple"])
    made = run([UV, "export", "--quiet", "--frozen", "--no-config", "--format", "cyclonedx1.5", *EXTRAS])
    path = folder / "sbom.cdx.json"
    path.write_text(_dated(made, released, when))
    return path


def _dated(made: bytes, released: str, when: int) -> str:
    """The same with the release's version and time, and a number that follows from what is in it."""
    found = json.loads(made)
    found["metadata"]["timestamp"] = f"{dt.datetime.fromtimestamp(when, dt.UTC):%Y-%m-%dT%H:%M:%SZ}"
    found["metadata"]["component"] |= {"version": released, "purl": f"pkg:pypi/hexapod-gateway@{released}"}
    del found["serialNumber"]
    found["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(found, sort_keys=True)).urn
    return json.dumps(found, indent=2) + "\n"
