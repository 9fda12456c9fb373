"""A first program: start one leg, move it, stop it. Each step is acknowledged."""

import argparse
import time

from gateway.client import DEFAULT_ENDPOINT, Client


def main(endpoint: str) -> None:
    with Client(endpoint, source="first program") as robot:
        print("state:", robot.state().mode)
        print("set before start:", robot.set_leg(3, 90, 90, 90).detail)
        print("start:", robot.start_leg(3, 90, 90, 90).accepted)
        for step in range(25):  # half a second: a running leg needs a command at least every 250 ms
            robot.set_leg(3, 90, 90 + step, 90 - step)
            time.sleep(0.02)
        print("stop:", robot.stop(3).accepted)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--connect", default=DEFAULT_ENDPOINT, metavar="ENDPOINT")
    main(arguments.parse_args().connect)
