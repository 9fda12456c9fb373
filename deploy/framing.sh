# Part of install.sh: which framing the controller needs. The installer cannot find out. Once the published STM32 firmware
# has heard the wrong framing, it hears nothing until it is reset, not even a Stop. So the installer asks first.

WHICH="length-prefixed for the published STM32 firmware, plain for a controller that follows the protocol's document"

# Sets `framing`. If the configuration lacks it, sets `said_framing` to a copy of the configuration that has it.
check_framing() {
	local file=$ETC/gateway.toml found=''
	if [ -d $ETC ] && [ ! -x $ETC ]; then # a dry run by somebody else than root
		fail "$ETC may be looked into by root only: sudo $0 --dry-run"
	fi
	if [ -e $file ] && ! is_blank $file; then
		found=$(framing_in $file) || fail "$file is not TOML, or its [spi] no table; fix it first"
	else
		file=$HERE/gateway.toml
	fi
	if [ -n "$found" ]; then
		[ "${framing:-$found}" = "$found" ] ||
			fail "$file says framing = \"$found\", and --framing $framing; change it there, or leave the option out"
		framing=$found
		return
	fi
	[ -n "$framing" ] || ask_framing
	said_framing=$(mktemp)
	with_framing <"$file" >"$said_framing"
	same_but_framing "$file" "$said_framing" ||
		fail "$file does not say which framing the controller needs; add framing = \"$framing\" to its spi settings"
}

ask_framing() {
	local answer
	[ -t 0 ] || fail "which framing does the controller need? Say --framing: $WHICH"
	printf '%s\n' "Which framing does the controller need?" \
		"  length-prefixed   the published STM32 firmware (once it has heard plain, only a reset brings it back)" \
		"  plain             a controller that reads frames as the protocol's document says" >&2
	until [ "$framing" = plain ] || [ "$framing" = length-prefixed ]; do
		printf 'length-prefixed or plain? ' >&2
		read -r answer || fail "which framing does the controller need? Say --framing: $WHICH"
		framing=$answer
	done
}

# The framing that a configuration says; nothing, if it says none.
framing_in() {
	"$python" -c 'import sys, tomllib
with open(sys.argv[1], "rb") as file: print(tomllib.load(file).get("spi", {}).get("framing", ""))' "$1" 2>/dev/null
}

# Copies a configuration from stdin to stdout and adds the framing: in place of its comment, below [spi], or at the end.
with_framing() {
	awk -v said="framing = \"$framing\"" '
		{ lines[NR] = $0 }
		/^[ \t]*\[/ { in_spi = 0 }
		/^[ \t]*\[[ \t]*spi[ \t]*\]/ { head = NR; in_spi = 1 }
		in_spi && /^# *framing *=/ { comment = NR }
		END {
			for (i = 1; i <= NR; i++) {
				print i == comment ? said : lines[i]
				if (i == head && !comment) print said
			}
			if (!head) print "\n[spi]\n" said
		}'
}

same_but_framing() {
	"$python" -c 'import sys, tomllib
before, after = (tomllib.load(open(path, "rb")) for path in sys.argv[1:3])
before.setdefault("spi", {})["framing"] = sys.argv[3]
sys.exit(before != after)' "$1" "$2" "$framing" 2>/dev/null
}

# A running service's kept configuration also gets the framing: without it, `stop-servos` after its end sends no Stop.
add_to_kept() {
	local kept=/run/$NAME/gateway.toml with
	[ -e $kept ] && [ -z "$(framing_in $kept)" ] || return 0
	with=$(with_framing <$kept)
	printf '%s\n' "$with" >$kept
}
