"""A session in cells: run them one by one in an editor or a notebook, or all at once from a shell."""

# %% Connect. `--connect ENDPOINT` for a robot elsewhere.
import sys
import time

from gateway.client import DEFAULT_ENDPOINT, Client, StoppedError

endpoint = sys.argv[sys.argv.index("--connect") + 1] if "--connect" in sys.argv else DEFAULT_ENDPOINT
robot = Client(endpoint, source="session")

# %% What does it know?
state = robot.state()
print(state, state.leg(3), f"watchdog {state.watchdog.timeout_ms:g} ms")
print(state.angles())

# %% Print the events from now on.
events = robot.on_event(lambda event: print("event:", event.kind, event.detail))

# %% Start all six legs. Without further commands the watchdog stops them after 250 ms, and publishes an event.
pose = [(90, 45, 120)] * 6
print(robot.start_legs(pose))
time.sleep(0.5)

# %% A rejected command raises; with `check=False` it returns the answer.
print(robot.set_legs(pose, check=False).detail)

# %% A stream without a `with`: its end stops the legs, and comes at the end of the program at the latest.
stream = robot.stream(hz=50).open()
for step in range(25):
    stream.set([(90, 45 + step, 120)] * 6)
print(stream, stream.jitter)
stream.close()

# %% The emergency stop, and how soon its Stops were written.
stopped = robot.estop()
print(f"{stopped.stop_frames} Stop frames within {stopped.latency_us:.0f} µs")

# %% It holds until somebody resets it, by its number or at least two seconds later.
try:
    robot.wait_ready()
except StoppedError as error:
    print(error, error.by, error.cause)
print(robot.reset())

# %% Leave.
events.undeclare()
robot.close()
