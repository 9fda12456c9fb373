# shellcheck shell=bash
# The version of what is built, with the commit that it is built from. Read by install.sh, wheels.sh and the release.

# Three commits with one version would be hard to tell apart on a robot. So "1.1.0" becomes "1.1.0+g4aa0d07", and
# "1.1.0+g4aa0d07.changed" where files differ from the commit; without git it stays, and so does a release's, whose
# commit has its version as a tag.
version_of() {
	local repository=$1 version commit state=''
	version=$(sed -n 's/^__version__ = "\(.*\)"$/\1/p' "$repository/gateway/__init__.py")
	# root installs from somebody else's repository, which git rejects unless it is named
	if commit=$(git -c safe.directory="$repository" -C "$repository" rev-parse --short=7 HEAD 2>/dev/null); then
		[ -z "$(git -c safe.directory="$repository" -C "$repository" status --porcelain -- pyproject.toml deploy gateway schemas)" ] ||
			state=.changed
		[ -n "$state" ] || ! git -c safe.directory="$repository" -C "$repository" tag --points-at HEAD | grep -qx "v$version" ||
			{
				printf '%s\n' "$version"
				return
			}
		version=$version+g$commit$state
	fi
	printf '%s\n' "$version"
}

# A copy of what a build needs: a build would leave files in the repository, and find old ones. With the times and modes
# of no particular machine: what is built from it is the same wherever that is.
copy_sources() {
	local repository=$1 to=$2 version=${3:-}
	cp -rL "$repository/pyproject.toml" "$repository/README.md" "$repository/LICENSE" "$repository/gateway" \
		"$repository/schemas" "$to"
	find "$to" -name __pycache__ -prune -exec rm -rf {} +
	sed -i "s/^__version__ = .*/__version__ = \"${version:-$(version_of "$repository")}\"/" "$to/gateway/__init__.py"
	find "$to" -mindepth 1 -exec chmod u=rwX,go=rX {} +
	find "$to" -mindepth 1 -exec touch --no-dereference --date="@${SOURCE_DATE_EPOCH:-$(date +%s)}" {} +
}

# When the commit was made: what a release is dated by. Now, without git.
epoch_of() {
	git -c safe.directory="$1" -C "$1" log -1 --format=%ct 2>/dev/null || date +%s
}
