"""`python -m tests.support.failing_output WHERE BUFFERED …`: our program, with a standard output that takes nothing.

WHERE: `full` (a full disk) or `closed` (a pipe whose reader has ended). BUFFERED: `yes` (as in a person's shell) or
`no` (as with PYTHONUNBUFFERED).
"""

import io
import os
import sys

from gateway.__main__ import main

if __name__ == "__main__":
    _, where, buffered, *arguments = sys.argv
    if where == "full":
        writable = os.open("/dev/full", os.O_WRONLY)
    else:
        readable, writable = os.pipe()
        os.close(readable)
    os.dup2(writable, 1)
    raw = io.FileIO(1, "w", closefd=False)
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(raw) if buffered == "yes" else raw,
        encoding="utf-8",
        write_through=buffered == "no",
    )
    sys.argv = ["hexapod-gateway", *arguments]
    main()
