"""`python -m release [--key FILE] [--processor aarch64 --python 3.11]`: fills dist/. `make dist` runs it."""

import argparse
import shutil
import sys
from pathlib import Path

from release.build import ROOT, build, epoch, version
from release.bundle import bundle, wheels
from release.documents import documents
from release.sums import SIGNATURE, SUMS, sign, write_sums


def main(arguments: list[str]) -> int:
    """Build, describe, sum up, sign; then the bundle for one kind of robot."""
    parser = argparse.ArgumentParser(prog="python -m release", description=__doc__)
    parser.add_argument("--to", type=Path, default=ROOT / "dist")
    parser.add_argument("--key", type=Path, help="Ed25519, made by: ssh-keygen -t ed25519 -f release")
    parser.add_argument("--processor", default="", help="whose bundle: aarch64 (default: this machine's)")
    parser.add_argument("--python", default="", help="of that machine: 3.11 for Raspberry Pi OS 12, 3.13 for 13")
    options = parser.parse_args(arguments)
    folder: Path = options.to
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.is_file():
            path.unlink()
    released, when = version(), epoch()
    made = [*build(folder, released, when), *documents(folder, released, when)]
    if options.key is not None:
        with_wheels = wheels(folder / "robot", made[0], when, options.processor, options.python)
        if not any(with_wheels.glob("spidev-*.whl")):
            sys.stdout.write(
                "The bundle has no spidev (`make wheels` says why): the gateway makes the kernel's calls itself.\n"
            )
        made.append(bundle(folder, with_wheels, released, when, options.key))
        shutil.rmtree(with_wheels)
    write_sums(folder, made)
    if options.key is not None:
        sign(folder, options.key)
    for path in [*made, folder / SUMS]:
        sys.stdout.write(f"{path}\n")
    if options.key is None:
        sys.stdout.write(f"Nothing is signed, and there is no bundle: --key names the key for {SIGNATURE}.\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
