"""In the virtual machine: `python -m tests.kernel.inside SCENE …` plays scenes and notes what each has found."""

import json
import sys
import traceback
from pathlib import Path

from tests.kernel.inside import wire
from tests.kernel.inside.scenes import ALL

OUT = Path("/run/kernel-test")


def main() -> None:
    """One line for each scene, as it ends."""
    for name in sys.argv[1:]:
        wire.heal()
        wire.forget()
        try:
            holds, found = True, ALL[name].play()
        except Exception as error:
            traceback.print_exc()
            holds, found = False, f"{error}".splitlines()[0] if f"{error}" else type(error).__name__
        line = {"scene": name, "holds": holds, "found": found}
        with (OUT / "scenes").open("a") as file:
            file.write(json.dumps(line) + "\n")


main()
