# shellcheck shell=bash
# What runs now: whether a servo does, and from which release. Read by install.sh.

# Has the number of the service's process from before the first change to what it runs or reads. While that process lives,
# it has not been restarted since: an installation was ended in between.
PENDING=/run/$NAME.restart

# Exit codes: 0 no servo runs, 10 one does, 11 the service does not say (it hangs, or has just begun), 12 the service's
# process has no such file mapped: it is of an older release, and a file that is there is another one's. The service writes
# the file ten times a second.
RUNS='
import sys, time
file, process = sys.argv[1:]
with open(f"/proc/{process}/maps") as maps:
    if not any(line.rstrip().endswith(f" {file}") for line in maps):
        sys.exit(12)
for _ in range(20):
    try:
        written_ns, running = map(int, open(file).read().split())
    except (OSError, ValueError):
        sys.exit(11)
    if time.monotonic_ns() - written_ns < 1_000_000_000:
        sys.exit(10 if running else 0)
    time.sleep(0.1)
sys.exit(11)
'
# The same, asked over Zenoh, for an older release. Its own Python runs this, and with the variables of its process: only
# it knows its settings and where it listens.
ASK='
import os, sys
with open(f"/proc/{sys.argv[1]}/environ", "rb") as variables:
    for each in variables.read().split(b"\0"):
        if each.startswith(b"HEXAPOD_"):
            os.environb.__setitem__(*each.split(b"=", 1))
try:
    from gateway.robot import settings
except ImportError:  # a release from before the two wings
    from gateway import settings
from gateway.client import Client
from gateway.errors import GatewayError
try:
    with Client(next(iter(settings.load(None, simulated=True).zenoh.listen), None), timeout_s=1) as robot:
        sys.exit(10 if any(servo.running for leg in robot.state().legs for servo in leg.servos) else 0)
except GatewayError:
    sys.exit(11)
'

# Whoever restarts the service of a robot that stands on its legs lets it fall. The release that runs is asked, whatever
# the links say by now.
check_no_servo_runs() {
	[ $force = no ] && systemctl is-active --quiet $NAME || return 0
	[ "$dry" = no ] || [ "$(id -u)" = 0 ] || return 0 # the file is for root and the service only
	local process release runs=0
	process=$(process_of $NAME)
	[ "$process" != 0 ] || return 0
	"${python:-/usr/bin/python3}" -c "$RUNS" /run/$NAME/servos "$process" || runs=$?
	if [ $runs = 12 ]; then
		runs=0
		release=$(release_of $NAME)
		"${release:-$OPT/venv}/bin/python" -c "$ASK" "$process" 2>/dev/null || runs=$?
	fi
	[ $runs != 10 ] || fail "a servo runs, and a restart would stop it: stop the robot first, or add --force"
	[ $runs = 0 ] ||
		fail "the service does not say whether a servo runs, and a restart would stop it: see that none does, and add --force"
}

# To be called before each change to what the service runs or reads.
will_restart() {
	check_no_servo_runs
	changed=yes
	[ "$dry" = yes ] || process_of $NAME >"$PENDING"
}

# Whether the service has not been restarted since it should have been.
restart_is_due() {
	local process
	process=$(process_of $NAME)
	[ "$process" != 0 ] && { [ "$(cat "$PENDING" 2>/dev/null)" = "$process" ] || runs_another $NAME; }
}

# The number of a service's process; 0: none.
process_of() { systemctl show --property=MainPID --value "$1"; }

# The release that a service's process runs, whatever the links say; nothing, if none runs or nobody may look.
release_of() {
	local process
	process=$(process_of "$1")
	[ "$process" != 0 ] || return 0
	grep --only-matching --max-count=1 "$OPT/venv-[^/ ]*" "/proc/$process/maps" 2>/dev/null || true
}

# Whether a service runs something else than the release that is installed.
runs_another() {
	local release
	release=$(release_of "$1")
	[ -n "$release" ] && [ "$release" != "$venv" ]
}
