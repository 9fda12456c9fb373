"""The command of docs/robot.md for a download: it names the key that has signed it, and each changed file."""

import re
import subprocess
from pathlib import Path

import pytest

from release.build import ROOT
from release.sums import SUMS, sign, write_sums

PACKAGE = "hexapod-gateway_1.1.0_arm64.deb"


@pytest.fixture
def download(tmp_path: Path) -> Path:
    """Return a package with the sums and the signature of a release that has more files."""
    key = tmp_path / "key"
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    folder = tmp_path / "download"
    folder.mkdir()
    for name in (PACKAGE, "other"):
        (folder / name).write_bytes(name.encode())
    write_sums(folder, list(folder.iterdir()))
    sign(folder, key)
    (folder / "other").unlink()
    return folder


def check(folder: Path) -> tuple[bool, str]:
    """Run the page's command there: whether all is well, and what it prints."""
    found = re.search(r"`(ssh-keygen -Y .*)`", (ROOT / "docs" / "robot.md").read_text())
    assert found is not None
    done = subprocess.run(["bash", "-c", found[1]], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stdout + done.stderr


def test_the_command_of_the_readme(download: Path) -> None:
    shown = subprocess.run(
        ["ssh-keygen", "-lf", download.parent / "key"], capture_output=True, text=True, check=True
    ).stdout
    ok, said = check(download)
    assert ok, said
    assert f'Good "hexapod-gateway-release" signature with ED25519 key {shown.split()[1]}' in said
    assert f"{PACKAGE}: OK" in said

    (download / PACKAGE).write_bytes(b"changed")
    ok, said = check(download)
    assert not ok
    assert f"{PACKAGE}: FAILED" in said
    write_sums(download, [download / PACKAGE])
    ok, said = check(download)
    assert not ok
    assert "Signature verification failed" in said or "incorrect signature" in said
    (download / f"{SUMS}.sig").unlink()
    assert not check(download)[0]
