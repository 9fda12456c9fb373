"""A session in cells: run them one by one in an editor or a notebook, or all at once from a shell."""

# %% Connect. `--connect ENDPOINT` for a robot elsewhere.
import sys
import time

from gateway.client import DEFAULT_ENDPOINT, Client

endpoint = sys.argv[sys.argv.index("--connect") + 1] if "--connect" in sys.argv else DEFAULT_ENDPOINT
robot = Client(endpoint, source="session")

# %% What does it know?
state = robot.state()
print(state.mode, state.spi.framing, f"watchdog {state.watchdog.timeout_ms:g} ms")

# %% Print the events from now on.
events = robot.on_event(lambda event: print("event:", event.kind, event.detail))

# %% Start a leg. Without further commands the watchdog stops it after 250 ms, and publishes an event.
print(robot.start_leg(1, 90, 45, 120))
time.sleep(0.5)

# %% The answer to a rejected command has the reason.
print(robot.set_leg(1, 90, 45, 120).detail)

# %% The emergency stop, and how soon its Stops were written.
stopped = robot.estop()
print(f"{stopped.stop_frames} Stop frames within {stopped.latency_us:.0f} µs")

# %% It holds until somebody resets it, by its number or at least two seconds later.
print(robot.start_leg(1, 90, 45, 120).reason)
print(robot.reset())

# %% Leave.
events.undeclare()
robot.close()
