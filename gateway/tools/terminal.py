"""What a command prints: results on stdout, remarks on stderr."""

import sys


def say(text: str) -> None:
    """A line of result, on stdout."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def hint(text: str) -> None:
    """A line for the person, on stderr, so that pipes carry results only."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
