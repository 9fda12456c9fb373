# Part of install.sh: which protocol and framing the controller needs. The installer cannot find out. Once the published
# STM32 firmware has heard anything else than its framing, it hears nothing until it is reset, not even a Stop. So the
# installer asks first. elkapod-2025 has no framing.

WHICH="length-prefixed for the published STM32 firmware, plain for a controller that follows the protocol's document"
ELKAPOD=elkapod-2025

# Sets `protocol`, and `setting` and `value`: what the configuration must state, a framing or that protocol. Where it
# does not, sets `stated` to a copy of the configuration that does.
check_controller() {
	local file=$ETC/gateway.toml found=''
	if [ -d $ETC ] && [ ! -x $ETC ]; then # a dry run by somebody else than root
		fail "$ETC may be looked into by root only: sudo $0 --dry-run"
	fi
	if [ -e $file ] && ! is_blank $file; then
		found=$(spi_setting protocol $file) || fail "$file is not TOML, or its [spi] no table; fix it first"
	else
		file=$HERE/gateway.toml
	fi
	[ -z "$found" ] || [ "${protocol:-$found}" = "$found" ] ||
		fail "$file says protocol = \"$found\", and --protocol $protocol; change it there, or leave the option out"
	protocol=${protocol:-$found}
	if [ "$protocol" = $ELKAPOD ]; then
		[ -z "$framing" ] || fail "--framing is for hexapod-1.0; leave it out with $ELKAPOD"
		setting=protocol value=$ELKAPOD
	else
		setting=framing
		found=$(spi_setting framing $file)
		[ -z "$found" ] || [ "${framing:-$found}" = "$found" ] ||
			fail "$file says framing = \"$found\", and --framing $framing; change it there, or leave the option out"
		value=${framing:-$found}
		[ -n "$value" ] || ask_framing
	fi
	[ -z "$found" ] || return 0
	stated=$(mktemp)
	with_setting <"$file" >"$stated"
	same_but_setting "$file" "$stated" ||
		fail "$file does not say which $setting the controller needs; add $setting = \"$value\" to its spi settings"
}

ask_framing() {
	[ -t 0 ] || fail "which framing does the controller need? Say --framing: $WHICH"
	printf '%s\n' "Which framing does the controller need?" \
		"  length-prefixed   the published STM32 firmware (once it has heard plain, only a reset brings it back)" \
		"  plain             a controller that reads frames as the protocol's document says" \
		"The Elkapod of 2025, with a UART beside SPI, has none: end this with Ctrl-C, and say --protocol $ELKAPOD" >&2
	until [ "$value" = plain ] || [ "$value" = length-prefixed ]; do
		printf 'length-prefixed or plain? ' >&2
		read -r value || fail "which framing does the controller need? Say --framing: $WHICH"
	done
}

# What a configuration's [spi] states for $1; nothing, if it does not.
spi_setting() {
	"$python" -c 'import sys, tomllib
with open(sys.argv[2], "rb") as file: print(tomllib.load(file).get("spi", {}).get(sys.argv[1], ""))' "$1" "$2" 2>/dev/null
}

# The UART that a configuration names.
uart_in() {
	"$python" -c 'import sys, tomllib
with open(sys.argv[1], "rb") as file: print(tomllib.load(file).get("controller", {}).get("uart", "/dev/ttyAMA1"))' "$1" 2>/dev/null
}

# Copies a configuration from stdin to stdout and adds the setting: in place of its comment, below [spi], or at the end.
with_setting() {
	awk -v said="$setting = \"$value\"" -v comment_of="^# *$setting *=" '
		{ lines[NR] = $0 }
		/^[ \t]*\[/ { in_spi = 0 }
		/^[ \t]*\[[ \t]*spi[ \t]*\]/ { head = NR; in_spi = 1 }
		in_spi && $0 ~ comment_of { comment = NR }
		END {
			for (i = 1; i <= NR; i++) {
				print i == comment ? said : lines[i]
				if (i == head && !comment) print said
			}
			if (!head) print "\n[spi]\n" said
		}'
}

same_but_setting() {
	"$python" -c 'import sys, tomllib
before, after = (tomllib.load(open(path, "rb")) for path in sys.argv[1:3])
before.setdefault("spi", {})[sys.argv[3]] = sys.argv[4]
sys.exit(before != after)' "$1" "$2" "$setting" "$value" 2>/dev/null
}

# A running service's kept configuration also gets the framing: without it, `stop-servos` after its end sends no Stop. It
# never gets another protocol than that service speaks.
add_to_kept() {
	local kept=/run/$NAME/gateway.toml with
	[ $setting = framing ] && [ -e $kept ] && [ -z "$(spi_setting framing $kept)" ] || return 0
	with=$(with_setting <$kept)
	printf '%s\n' "$with" >$kept
}
