"""A first program: start the six legs, move them, stop them. Each step is acknowledged."""

import argparse
import time

from gateway.client import DEFAULT_ENDPOINT, Client, RejectedError

LEGS = range(1, 7)


def main(endpoint: str) -> None:
    with Client(endpoint, source="first program") as robot:
        print("state:", robot.wait_ready())
        try:
            robot.set_legs(dict.fromkeys(LEGS, (90, 90, 90)))
        except RejectedError as error:
            print("set before start:", error.detail)
        print("start:", robot.start_legs(dict.fromkeys(LEGS, (90, 90, 90))))
        for step in range(25):  # half a second: a running leg needs a command at least every 250 ms
            robot.set_legs(dict.fromkeys(LEGS, (90, 90 + step, 90 - step)))
            time.sleep(0.02)
        print("stop:", robot.stop())


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    main(arguments.parse_args().connect)
