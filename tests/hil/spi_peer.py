"""A program with the unmodified spidev that does what it is told on standard input, a JSON line at a time.

In: `["writebytes2", "0e01"]` calls a method of the SpiDev (bytes in hex), `["set", "mode", 0]` sets an attribute and
answers what it reads back, `["flock"]` locks the device, `["time", "xfer3", "0e01", 1000]` answers µs per call.
Out: `{"ok": result}` or `{"errno": 5, "type": "OSError"}`.
"""

import fcntl
import json
import os
import sys
import time

import spidev


def perform(spi: spidev.SpiDev, name: str, arguments: list[object]) -> object:
    """Do one line's work; what it returns goes back as JSON."""
    match name, arguments:
        case "set", [str(attribute), value]:
            setattr(spi, attribute, value)
            result = getattr(spi, attribute)
        case "get", [str(attribute)]:
            result = getattr(spi, attribute)
        case "exists", [str(path)]:
            result = os.path.exists(path)
        case "flock", []:
            fcntl.flock(spi.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
            result = None
        case "time", [str(method), str(data), int(count)]:
            call, values = getattr(spi, method), bytes.fromhex(data)
            begin_ns = time.monotonic_ns()
            for _ in range(count):
                call(values)
            result = (time.monotonic_ns() - begin_ns) / count / 1000
        case "writebytes" | "writebytes2" | "xfer" | "xfer2" | "xfer3", [str(data), *options]:
            result = getattr(spi, name)(list(bytes.fromhex(data)), *options)
        case _:
            result = getattr(spi, name)(*arguments)
    return result


def main() -> None:
    """Answer each line until standard input ends."""
    spi = spidev.SpiDev()
    for line in sys.stdin:
        name, *arguments = json.loads(line)
        try:
            answer: dict[str, object] = {"ok": perform(spi, name, arguments)}
        except (OSError, SystemError) as error:  # SystemError: spidev's answer to a short write
            answer = {"errno": getattr(error, "errno", None), "type": type(error).__name__}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
