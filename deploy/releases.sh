# shellcheck shell=bash
# shellcheck source=deploy/recorder.sh
. "$HERE/recorder.sh"
# Which release the service runs ($OPT/venv, a link to a folder of its own), and the one before it. Read by install.sh.

# Starts a gateway from a folder with a simulated controller and its configuration, and ends it once it is ready.
TRIAL='
import os, signal, socket, subprocess, sys
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
own = {"HEXAPOD_ZENOH__LISTEN": f"[\"tcp/127.0.0.1:{port}\"]", "HEXAPOD_ZENOH__CONNECT": "[]"}
from gateway.settings import Settings
if "recorder" in Settings.model_fields:
    own["HEXAPOD_RECORDER__PATH"] = ""  # that of the service, which root must not begin
own |= {"HEXAPOD_ZENOH__CONFIG": "", "HEXAPOD_TELEMETRY__METRICS": "", "HEXAPOD_LOG__LEVEL": "error"}
gateway = subprocess.Popen([*sys.argv[1:]], env={**os.environ, **own}, stdout=subprocess.PIPE, text=True)
signal.signal(signal.SIGALRM, lambda *_: gateway.kill())
signal.alarm(30)
ready = "is ready" in gateway.stdout.readline()
gateway.terminate()
sys.exit(not ready or gateway.wait() != 0)
'
# 10: a servo runs. Anything else: none does, or nobody says (no answer without a certificate, an old release).
RUNS='
import sys
from gateway import settings
from gateway.client import Client
from gateway.errors import GatewayError
try:
    with Client(next(iter(settings.load(None, simulated=True).zenoh.listen), None), timeout_s=1) as robot:
        sys.exit(10 if any(servo.running for leg in robot.state().legs for servo in leg.servos) else 0)
except GatewayError:
    sys.exit(2)
'

link() {
	run ln -sfn "$1" "$2.new"
	run mv -T "$2.new" "$2"
}

try_release() {
	say "start $venv with a simulated controller"
	[ "$dry" = no ] || return 0
	# Twice: the free port that was found may have been taken before it was listened on.
	local try
	for try in 1 2; do
		"$venv/bin/python" -c "$TRIAL" "$venv/bin/$NAME" run --sim --config $ETC/gateway.toml && return
	done
	fail "$venv does not start (above is why); the service stays as it was"
}

# Whoever upgrades a robot that stands on its legs lets it fall.
check_no_servo_runs() {
	[ $force = no ] && systemctl is-active --quiet $NAME && [ -x "$OPT/venv/bin/python" ] || return 0
	local runs=0
	"$OPT/venv/bin/python" -c "$RUNS" 2>/dev/null || runs=$?
	[ $runs != 10 ] || fail "a servo runs, and a restart would stop it: stop the robot first, or add --force"
}

# The service runs $venv from now on, and can go back to what it ran before, unit file included.
switch_release() {
	before=$(readlink -e $OPT/venv || true)
	[ "$before" != "$venv" ] || return 0
	check_no_servo_runs
	try_release
	if [ -n "$before" ]; then
		[ ! -e $UNIT ] || run cp $UNIT "$before/unit"
		link "$before" $OPT/previous
	fi
	say "let $OPT/venv be $venv"
	link "$venv" $OPT/venv
	changed=yes
}

# Start the service anew; where it does not come up, go back.
restart_service() {
	run systemctl restart $NAME && return
	[ -n "$before" ] && [ "$before" != "$venv" ] ||
		fail "installed, but it does not start: journalctl -u $NAME says why"
	link "$before" $OPT/venv
	[ ! -e "$before/unit" ] || install -m 0644 "$before/unit" $UNIT
	systemctl daemon-reload
	systemctl reset-failed $NAME 2>/dev/null || true
	systemctl restart $NAME || fail "neither $venv nor $before starts: journalctl -u $NAME says why"
	fail "$venv does not start, so $before runs again: journalctl -u $NAME says why"
}

rollback() {
	venv=$(readlink -e $OPT/previous) || fail "there is no release before this one to go back to"
	switch_release
	if [ -e "$venv/unit" ]; then run install -m 0644 "$venv/unit" $UNIT; fi
	run systemctl daemon-reload
	say "restart the service: all legs stop"
	restart_service
	[ ! -e "$CONSOLE_UNIT" ] || run systemctl try-restart "$CONSOLE"
}
