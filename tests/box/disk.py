"""A disk whose power can be cut: an ext4 image, of which a copy holds what had reached the disk by then, and no more.

The kernel keeps what programs write in memory for up to 30 s. What is in the image's file is what it has given to the
disk; so a box that boots from a copy of that file is the robot after a power cut. The file lies on XFS, which copies it
as it is at one moment, whatever is being written: each write is in the copy as a whole, or is missing.
"""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

SIZE = "2G"  # sparse; an installation takes some 200 MB
ROOM = "16G"  # sparse; copies share what they have in common


@contextmanager
def copies_at_once(folder: Path) -> Iterator[Path]:
    """A folder in which disks can be cut. What lies there is gone afterwards."""
    room = folder.with_name(f"{folder.name}.xfs")
    subprocess.run(["truncate", f"--size={ROOM}", str(room)], check=True)
    subprocess.run(["mkfs.xfs", "-q", "-m", "reflink=1", str(room)], check=True)
    subprocess.run(["mount", "-o", "loop", str(room), str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
        room.unlink()


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
        subprocess.run(["cp", "--reflink=always", str(self.image), str(copy)], check=True)
        return Disk(copy)
