# shellcheck shell=bash
# The process that keeps the black box's incidents, beside the service. Read by install.sh.

RECORDER=hexapod-recorder
RECORDER_UNIT=/etc/systemd/system/$RECORDER.service
STATE=/var/lib/$NAME

# After the service: nothing of it is needed for the robot to move or to stop.
start_recorder() {
	local released=$changed
	changed=no
	put "$HERE/systemd/$RECORDER.service" $RECORDER_UNIT 0644
	[ $changed = no ] || run systemctl daemon-reload
	if ! systemctl is-enabled --quiet $RECORDER 2>/dev/null; then
		say "enable $RECORDER: it keeps what the black box has of stops and faults, in $STATE"
		run systemctl enable --quiet $RECORDER
	fi
	if [ "$changed$released" != nono ] || ! systemctl is-active --quiet $RECORDER || runs_another $RECORDER; then
		run systemctl restart $RECORDER || say "$RECORDER does not start: journalctl -u $RECORDER says why"
	fi
}

remove_recorder() {
	if [ -e $RECORDER_UNIT ]; then
		say "remove $RECORDER_UNIT"
		run systemctl disable --quiet --now $RECORDER
		run rm $RECORDER_UNIT
	fi
	run rm -rf /run/$NAME
	if [ -d $STATE ]; then
		say "keep $STATE, your incidents, for root only"
		run chown -R root:root $STATE
		run chmod -R go= $STATE
	fi
}
