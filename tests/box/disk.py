"""A disk whose power can be cut: an ext4 image, of which a copy holds what had reached the disk by then, and no more.

The kernel keeps what programs write in memory for up to 30 s. What is in the image's file is what it has given to the
disk; so a box that boots from a copy of that file is the robot after a power cut.
"""

import os
import subprocess
from pathlib import Path
from typing import Self

SIZE = "2G"  # sparse; an installation takes some 200 MB
COPIES = 20
"""Attempts to copy at a moment when nothing is written. The kernel writes in bursts, some seconds apart."""


class Disk:
    """An image that a box runs from."""

    def __init__(self, image: Path) -> None:
        self.image = image

    @classmethod
    def new(cls, image: Path) -> Self:
        """An empty one. Nothing is left for the kernel to initialise in the background, as on a card in use."""
        options = "lazy_itable_init=0,lazy_journal_init=0"
        subprocess.run(["mkfs.ext4", "-q", "-E", options, str(image), SIZE], check=True, capture_output=True)
        return cls(image)

    def cut(self, copy: Path) -> "Disk":
        """What would be on the disk if the power failed now."""
        for _ in range(COPIES):
            before = self.writes()
            subprocess.run(["cp", "--sparse=always", str(self.image), str(copy)], check=True)
            if self.writes() == before:
                return Disk(copy)
        raise TimeoutError(f"{self.image} was written to all the time")

    def writes(self) -> int:
        """What the disk was asked to write, in requests and sectors; a copy is of one moment if none came meanwhile."""
        stat = Path(f"/sys/block/{self._device()}/stat").read_text().split()
        return int(stat[4]) + int(stat[6])

    def _device(self) -> str:
        for device in Path("/sys/block").glob("loop*"):
            file = device / "loop/backing_file"
            if file.exists() and os.path.samefile(file.read_text().strip(), self.image):
                return device.name
        raise FileNotFoundError(f"no box runs from {self.image}")
