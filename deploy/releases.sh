# shellcheck shell=bash
# Which release the service runs ($OPT/venv, a link to a folder of its own), and the one before it. Read by install.sh.

# Starts a gateway from a folder with a simulated controller and its configuration, and ends it once it is ready.
TRIAL='
import os, signal, socket, subprocess, sys
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
own = {"HEXAPOD_ZENOH__LISTEN": f"[\"tcp/127.0.0.1:{port}\"]"}
try:
    from gateway.robot.settings import Settings
except ImportError:  # a release that is kept from before the two wings
    from gateway.settings import Settings
fields = Settings.model_fields
if "log" in fields:  # a release that is kept from before these two were removed
    own |= {"HEXAPOD_ZENOH__CONNECT": "[]", "HEXAPOD_LOG__LEVEL": "error"}
# The state belongs to the service, and root must not begin it. A release that is kept may be from before state.path.
own |= {"HEXAPOD_STATE__PATH": ""} if "state" in fields else {"HEXAPOD_RECORDER__PATH": ""} if "recorder" in fields else {}
own |= {"HEXAPOD_ZENOH__CONFIG": "", "HEXAPOD_TELEMETRY__METRICS": ""}
gateway = subprocess.Popen([*sys.argv[1:]], env={**os.environ, **own}, stdout=subprocess.PIPE, text=True)
signal.signal(signal.SIGALRM, lambda *_: gateway.kill())
signal.alarm(30)
ready = "is ready" in gateway.stdout.readline()
gateway.terminate()
sys.exit(not ready or gateway.wait() != 0)
'
link() {
	run ln -sfn "$1" "$2.new"
	run mv -T "$2.new" "$2"
}

# With the rights of the service's user: neither what root may read nor its priorities are the service's.
try_release() {
	say "start $venv with a simulated controller"
	[ "$dry" = no ] || return 0
	local try
	# Twice: the free port that was found may have been taken before it was listened on.
	for try in 1 2; do
		setpriv --reuid=$NAME --regid=$NAME --clear-groups \
			"$venv/bin/python" -c "$TRIAL" "$venv/bin/$NAME" run --sim --config $ETC/gateway.toml && return
	done
	if [ "$venv" != "$(readlink -e $OPT/venv || true)" ] && [ "$venv" != "$(readlink -e $OPT/previous || true)" ]; then
		rm -rf "$venv"
	fi
	fail "$venv does not start (above is why); the service stays as it was"
}

# The service runs $venv from now on, and can go back to what it ran before, unit file included.
switch_release() {
	before=$(readlink -e $OPT/venv || true)
	[ "$before" = "$venv" ] || check_no_servo_runs
	try_release
	[ "$before" != "$venv" ] || return 0
	will_restart # and the robot may have begun to move meanwhile
	if [ -n "$before" ] && is_fit "$before"; then
		earlier=$(readlink -e $OPT/previous || true)
		say "from $(version_in "$before") to $to"
		if [ -s $UNIT ] && [ "$dry" = no ]; then
			cp $UNIT "$before/unit.new"
			replace "$before/unit"
		fi
		link "$before" $OPT/previous
	else
		before=''
	fi
	say "let $OPT/venv be $venv"
	link "$venv" $OPT/venv
}

# Start the service anew; where it does not come up, go back.
restart_service() {
	check_no_servo_runs
	say "restart the service: all legs stop"
	run systemctl restart $NAME && return
	[ -n "$before" ] && [ "$before" != "$venv" ] ||
		fail "installed, but it does not start: journalctl -u $NAME says why"
	link "$before" $OPT/venv
	# What was there to go back to before this attempt is so again.
	if [ -n "$earlier" ] && [ "$earlier" != "$before" ] && [ "$earlier" != "$venv" ]; then
		link "$earlier" $OPT/previous
	else
		rm -f $OPT/previous
	fi
	if [ -s "$before/unit" ]; then
		install -m 0644 "$before/unit" $UNIT.new
		replace $UNIT
	fi
	flush
	systemctl daemon-reload
	systemctl reset-failed $NAME 2>/dev/null || true
	systemctl restart $NAME || fail "neither $venv nor $before starts: journalctl -u $NAME says why"
	rm -rf "$venv"
	fail "$venv does not start, so $before runs again: journalctl -u $NAME says why"
}

rollback() {
	venv=$(readlink -e $OPT/previous) || fail "there is no release before this one to go back to"
	[ "$venv" != "$(readlink -e $OPT/venv || true)" ] || fail "there is no release before this one to go back to"
	is_fit "$venv" || fail "$venv, the release before this one, is not as it was installed; install it anew"
	to=$(version_in "$venv")
	switch_release
	if [ -s "$venv/unit" ]; then put "$venv/unit" $UNIT 0644; fi
	run systemctl daemon-reload
	flush
	restart_service
	rollback_console
	flush
}

# All but what runs and what can be gone back to.
remove_old_releases() {
	local old kept
	kept=$(readlink -e $OPT/previous || true)
	[ "$dry" = no ] || [ -z "$before" ] || [ "$before" = "$venv" ] || kept=$before
	for old in "$OPT"/venv-*; do
		[ "$old" != "$venv" ] && [ "$old" != "$kept" ] && [ -d "$old" ] || continue
		say "remove $old, which nothing uses any more"
		run rm -rf "$old"
	done
}
