"""`python -m release [--key FILE]`: fills dist/. `make dist` runs it."""

import argparse
import sys
from pathlib import Path

from release.build import ROOT, build, epoch, version
from release.deb import PROCESSORS, deb_with_dependencies
from release.documents import SIGNATURE, SUMS, sbom, sign, write_sums


def main(arguments: list[str]) -> int:
    """Build, describe, sum up, sign."""
    parser = argparse.ArgumentParser(prog="python -m release", description=__doc__)
    parser.add_argument("--to", type=Path, default=ROOT / "dist")
    parser.add_argument("--key", type=Path, help="Ed25519, made by: ssh-keygen -t ed25519 -f release")
    options = parser.parse_args(arguments)
    folder: Path = options.to
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.is_file():
            path.unlink()
    released, when = version(), epoch()
    made = [*build(folder, released, when), sbom(folder, released, when)]
    made += [deb_with_dependencies(folder, made[0], released, when, architecture) for architecture in PROCESSORS]
    write_sums(folder, made)
    if options.key is not None:
        sign(folder, options.key)
    else:
        sys.stdout.write(f"Nothing is signed: --key names the key for {SIGNATURE}.\n")
    for path in [*made, folder / SUMS]:
        sys.stdout.write(f"{path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
