"""A page of memory that two processes share."""

import mmap
import os


class SharedPage:
    """It goes one way, and the writer never waits: it does not notice whether anybody reads, or is too slow.

    An aligned number of eight bytes is written whole.
    """

    def __init__(self, fd: int | None = None) -> None:
        """A new page of zeros; with `fd` the one that another process has made and passed on."""
        self.fd = os.memfd_create("page") if fd is None else fd
        """No disk is behind it, so a write never waits for one."""
        if fd is None:
            os.ftruncate(self.fd, mmap.PAGESIZE)
        self._memory = mmap.mmap(self.fd, mmap.PAGESIZE)
