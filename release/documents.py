"""What says what is in a release: the lock in both forms, and the SBOM (CycloneDX), all from uv.lock."""

import datetime as dt
import json
import shutil
import uuid
from pathlib import Path

from release.build import ROOT, UV, run

EXTRAS = ("--extra", "spi", "--extra", "console", "--extra", "power")


def documents(folder: Path, released: str, when: int) -> list[Path]:
    """pylock.toml, requirements.txt (as deploy/lock has it) and sbom.cdx.json in `folder`."""
    run([UV, "lock", "--check", "--no-config", "--default-index", "https://pypi.org/simple"])
    pylock, requirements, sbom = (folder / name for name in ("pylock.toml", "requirements.txt", "sbom.cdx.json"))
    pylock.write_bytes(_export("pylock.toml", "--no-header", "--no-emit-project"))
    shutil.copyfile(ROOT / "deploy" / "lock" / "requirements.txt", requirements)
    sbom.write_text(_sbom(_export("cyclonedx1.5"), released, when))
    return [pylock, requirements, sbom]


def _export(form: str, *options: str) -> bytes:
    return run([UV, "export", "--quiet", "--frozen", "--no-config", "--format", form, *options, *EXTRAS])


def _sbom(made: bytes, released: str, when: int) -> str:
    """The same with the release's version and time, and a number that follows from what is in it."""
    found = json.loads(made)
    found["metadata"]["timestamp"] = f"{dt.datetime.fromtimestamp(when, dt.UTC):%Y-%m-%dT%H:%M:%SZ}"
    found["metadata"]["component"] |= {"version": released, "purl": f"pkg:pypi/hexapod-gateway@{released}"}
    del found["serialNumber"]
    found["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(found, sort_keys=True)).urn
    return json.dumps(found, indent=2) + "\n"
