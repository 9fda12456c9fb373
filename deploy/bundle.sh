# shellcheck shell=bash
# A signed bundle: looked at as a whole before anything of it is unpacked. Read by install.sh.
#
# A tar with files only: SHA256SUMS, which names every other file, SHA256SUMS.sig (ssh-keygen -Y), release.pub, and what
# `make wheels` makes. ssh-keygen: every Raspberry Pi OS has it, and it verifies before any Python package is there.

NAMESPACE=hexapod-gateway-release
TRUSTED=$ETC/release.pub
NO_SUM='SHA256SUMS SHA256SUMS.sig'

# Goes on with the installer that is in the bundle; fails, before anything is changed, with one sentence.
open_bundle() {
	local signer names kinds name sum given known copy
	command -v ssh-keygen >/dev/null || fail "ssh-keygen is missing: sudo apt-get install openssh-client"
	unpacked=$(mktemp -d /var/tmp/$NAME.XXXXXX)
	copy=$unpacked/bundle # what is verified is what is unpacked, whoever can write to the original
	cp "$bundle" "$copy"
	names=$(tar -tf "$copy" 2>/dev/null) || fail "$bundle is no bundle of \`make dist\`, or was cut off; nothing was changed"
	# Here-strings, no pipes: grep -q goes at the first match, and pipefail would take the writer's end for "none".
	kinds=$(tar -tvf "$copy" | cut -c1)
	! grep -qv '^-$' <<<"$kinds" || fail "$bundle has something else than files in it; nothing was changed"
	if grep -q / <<<"$names" || [ -n "$(printf '%s\n' "$names" | sort | uniq -d)" ]; then
		fail "$bundle has a file in a folder, or one twice, as no bundle of \`make dist\` has; nothing was changed"
	fi
	for name in $NO_SUM release.pub; do
		if grep -qxF "$name" <<<"$names"; then
			tar -xOf "$copy" "$name" >"$unpacked/$name"
		elif [ "$name" = SHA256SUMS.sig ]; then
			fail "$bundle is not signed; nothing was changed"
		else
			fail "$bundle has no $name; nothing was changed"
		fi
	done
	signer=$(ssh-keygen -Y check-novalidate -n $NAMESPACE -s "$unpacked/SHA256SUMS.sig" <"$unpacked/SHA256SUMS" 2>/dev/null |
		sed -n 's/.* key \(SHA256:[^ ]*\)$/\1/p') || true
	[ -n "$signer" ] || fail "the signature of $bundle is not of its sums: it was changed; nothing was done"
	check_signer "$signer"
	printf 'release namespaces="%s" %s\n' $NAMESPACE "$(cut -d' ' -f1,2 "$unpacked/release.pub")" >"$unpacked/signers"
	ssh-keygen -Y verify -f "$unpacked/signers" -I release -n $NAMESPACE -s "$unpacked/SHA256SUMS.sig" \
		<"$unpacked/SHA256SUMS" >/dev/null 2>&1 ||
		fail "the signature of $bundle is not that of the key in it; nothing was changed"
	given=$(printf '%s\n' "$names" | grep -vx -e SHA256SUMS -e SHA256SUMS.sig | LC_ALL=C sort)
	known=$(sed 's/^[0-9a-f]*  //' "$unpacked/SHA256SUMS" | LC_ALL=C sort)
	[ "$given" = "$known" ] || fail "$bundle has other files than its sums name; nothing was changed"
	while read -r sum name; do
		[ "$(tar -xOf "$copy" "$name" | sha256sum | cut -d' ' -f1)" = "$sum" ] ||
			fail "$name in $bundle is not what was released: it was changed; nothing was done"
	done <"$unpacked/SHA256SUMS"
	check_not_older "$(printf '%s\n' "$names" | sed -n 's/^hexapod_gateway-\([^-]*\)-.*\.whl$/\1/p')"
	mkdir "$unpacked/files"
	tar -xf "$copy" -C "$unpacked/files" --no-same-owner --no-same-permissions
	rm "$copy"
	wheels=$unpacked/files
	say "$bundle is what the key $signer has signed"
	[ -s "$TRUSTED" ] && cmp -s "$unpacked/release.pub" "$TRUSTED" ||
		say "this key is trusted from now on: compare it with the one that the project names"
	# The unit, the rules and what the installer does belong to its release.
	"$python" -m zipfile -e "$wheels"/hexapod_gateway-*.whl "$unpacked/own"
	exec bash "$unpacked/own/gateway/deploy/install.sh" --opened "$unpacked" "${handed_on[@]}"
}

# The key is trusted at the first installation; another one has to be named.
check_signer() {
	local signer=$1 now=''
	[ ! -s "$TRUSTED" ] || now=$(ssh-keygen -lf "$TRUSTED" 2>/dev/null | cut -d' ' -f2)
	if [ -n "$trust" ] && [ "$trust" != "$signer" ]; then
		fail "$bundle is signed by the key $signer, and --trust names $trust; nothing was changed"
	fi
	if [ -n "$now" ] && [ "$now" != "$signer" ] && [ -z "$trust" ]; then
		fail "$bundle is signed by another key ($signer) than this robot trusts ($now); if the project says that its key has changed: --trust $signer"
	fi
}

# An older release has the mistakes that a newer one has lost.
check_not_older() {
	local offered=$1 present
	[ -n "$offered" ] || fail "$bundle has no hexapod_gateway-*.whl; nothing was changed"
	present=$(version_in "$OPT/venv" 2>/dev/null || true)
	[ -n "$present" ] && [ $allow_downgrade = no ] || return 0
	[ "$(printf '%s\n%s\n' "${offered%%+*}" "${present%%+*}" | sort -V | head -n 1)" = "${present%%+*}" ] ||
		fail "$bundle has release $offered, and $present is installed, which is newer; if that is meant: --allow-downgrade"
}

# Once the rest is there.
keep_trust() {
	[ -z "$opened" ] || put "$unpacked/release.pub" "$TRUSTED" 0644
}
