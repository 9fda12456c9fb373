"""`hexapod-gateway`, and `python -m gateway`."""

import os
import sys

from gateway.host import output


def main() -> None:
    """The console script. `stop-servos` and the first Stops of `run` wait for no import of another command."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")  # the search for plug-ins takes 30 ms, and finds none
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            # The stream is closed, and the next file would get its number: the SPI device must never become stderr.
            # closefd=False keeps the number taken, even if this object is replaced.
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r+", closefd=False))
    output.guard()
    if sys.argv[1:2] == ["stop-servos"]:
        from gateway.onboard import stop

        code = stop.at_once(sys.argv[2:])
        if code is not None:
            sys.exit(output.finish(code))
    try:
        try:
            if sys.argv[1:2] == ["run"]:
                from gateway.onboard import stop

                stop.before_service(sys.argv[2:])
            from gateway import cli
        except KeyboardInterrupt:  # on a Raspberry Pi the import takes seconds
            sys.exit(130)
        cli.main()
    except Exception:
        if sys.argv[1:2] != ["check"]:
            raise
        from gateway.onboard import whole

        damage = whole.why_nothing_loads()
        if not damage:
            raise
        sys.stdout.write(f"failure  package        {damage}\n")
        sys.exit(output.finish(1))


if __name__ == "__main__":
    main()
