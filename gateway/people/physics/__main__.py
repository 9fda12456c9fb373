"""`python -m gateway.people.physics`: the process that simulates the body, started by `run --sim=physics`."""

import os
import sys

from gateway.people.physics.process import main

if __name__ == "__main__":
    os._exit(main(sys.argv[1:]))  # not by the interpreter's own end, which aborts while a thread is inside Zenoh
