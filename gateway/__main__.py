"""`hexapod-gateway`, and `python -m gateway`."""

import os
import sys


def main() -> None:
    """The console script. `stop-servos` first: it must not wait for what only the other commands use."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            # It is closed, so the next file would get its number; the SPI device must never become stderr, even once
            # something else takes the place of this object. So the number stays taken.
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r+", closefd=False))
    if sys.argv[1:2] == ["stop-servos"]:
        from gateway.onboard import stop

        code = stop.at_once(sys.argv[2:])
        if code is not None:
            sys.exit(code)
    try:
        try:
            from gateway import cli
        except KeyboardInterrupt:  # on a Raspberry Pi it takes seconds, in which somebody may have changed their mind
            sys.exit(130)
        cli.main()
    except Exception:
        if sys.argv[1:2] != ["check"]:
            raise
        from gateway.onboard import whole

        damage = whole.why_nothing_loads()
        if not damage:
            raise
        sys.stdout.write(f"failure  release        {damage}\n")
        sys.exit(1)


if __name__ == "__main__":
    main()
