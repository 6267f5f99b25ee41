# make install   put capture-app and reconstruct on the PATH (EXTRAS=export,plots,pictures,rerun,cluster: those too)
# make install-capture   the same without reconstruction, for machines that only capture      make uninstall
# make demo   capture a synchronized burst with five simulated cameras and compare it with offset frames
# make test   the unit tests, in about 4 minutes        make check   lint, types, architecture          make format
# make test KIND=core   the unit tests without those of cameras, programs, companions and methods
# make test KIND=system   rigs of processes, browsers, whole comparisons, pages that newcomers read (20 minutes)
# make test KIND=nightly   all pages, all seeds, crafted files, writers killed at every step (hours; PART=3/12: a twelfth of them)
# make test KIND=debian   README's commands, as typed, on bare Debians (root; PART=1/2: Debian 12, PART=2/2: 13)
# make test NEWEST=1   the unit tests with the newest release of everything, in build/newest (remove it to try still newer ones)
# make test KIND=examples   the property tests with new random examples, ten times as many (some minutes)
# make test KIND=phones   the page of phones in real browsers
# make test KIND=docs   every command line of README and docs, run beside a simulated rig (some minutes)
# make test KIND=v4l2   the rig on real camera drivers in a virtual machine (slow)
# make test KIND=libcamera   the rig on real libcamera and the real uvcvideo driver in a virtual machine (slow; root)
# make test KIND=gige   three GigE Vision cameras of aravis's own making in network namespaces (root, gir1.2-aravis-0.8, gcc; 5 min)
# make test KIND=mixed   one rig of five kinds: libcamera's double, GigE Vision, a browser, a simulated phone, a recording (root, as KIND=gige, and Chromium)
# make test KIND=windows   unit tests, rigs and reconstruction with a real Windows Python under Wine (root, 3 GB; 15 min)
# make test KIND=slurm   batches on a real SLURM of this one machine (root)
# make coverage   the branches that unit tests take of nodes, of session's writing, of importing, of the rig's sync (4 min)
# make readers   the programs that exports are for, so that `make test KIND=system` tries each export with them (950 MB)
# make test-dist   wheel and sdist in clean environments, with the demo (PYTHONS="python3.11 python3.13": with these)
# make bench NAME=...   one of the benchmarks, with arguments in BENCH="..." (make help names them)
# make fuzz SECONDS=120   every reader of strangers' bytes under a coverage-guided fuzzer, so many seconds each (FUZZ="datagram": that one)
# make samples   render the sample sessions again from their recipes: the same times, truth and pictures
# make pictures NAME=screenshots   the pictures of the screen in docs/images, from a real run with simulated cameras
# make pictures NAME=animation   film a take on the real screen for README, a minute or two
# make pictures NAME=calibration   the pictures of docs/calibration.md, from the simulator (a minute)
# make wheel   a wheel of this checkout, in dist      make dist   a wheel and an sdist
# make wheels   wheels for Linux, Windows and macOS, with kernels that ziglang compiles, in dist (five minutes)
# make docs   the documentation as a site, in build/site; a link or a name that leads nowhere fails
# make help   all targets

PYTHON ?= python3
# NEWEST=1: an environment of its own, in which all packages are as new as pip finds them.
VENV ?= $(if $(NEWEST),build/newest,.venv)
RELEASES := $(if $(NEWEST),--upgrade --upgrade-strategy eager,-c constraints.txt)
BIN := $(VENV)/bin
OUT ?= demo
PYTHONS ?= $(PYTHON)
SECONDS ?= 120

# What Open3D's wheel loads from the system: library and the Debian package that has it.
LIBRARIES := libGL.so.1:libgl1 libEGL.so.1:libegl1 libX11.so.6:libx11-6 \
	libusb-1.0.so.0:libusb-1.0-0 libudev.so.1:libudev1 libidn2.so.0:libidn2-0

# Tests wait half of their time for processes and screens: more workers than cores.
WORKERS ?= $(shell expr $$(nproc 2>/dev/null || echo 2) + 2)

# Containers often set it. Then each worker, and each of the hundreds of programs that tests start, compiles all that
# it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install install-capture uninstall demo test coverage readers test-dist bench fuzz samples pictures wheel wheels dist docs check format clean python system slurm
.DEFAULT_GOAL := help

help:
	@sed -n 's/^# make /make /p' Makefile
	@$(PYTHON) -m benchmarks

install: | system
	PYTHON=$(PYTHON) ./install.sh $(if $(EXTRAS),--with $(EXTRAS))

install-capture: | python
	PYTHON=$(PYTHON) ./install.sh --capture-only $(if $(EXTRAS),--with $(EXTRAS))

uninstall:
	./install.sh --remove

wheel: $(VENV)/.installed
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

# Zig's words for the machines that wheels are built for; hatch_build.py has their tags.
TARGETS := x86_64-linux-gnu.2.17 aarch64-linux-gnu.2.17 x86_64-windows-gnu aarch64-macos.11.0 x86_64-macos.11.0

wheels: $(VENV)/.installed
	for target in $(TARGETS); do \
	  SIMULSHOT_TARGET=$$target $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist . || exit 1; \
	done

dist: $(VENV)/.installed-dev
	rm -rf dist
	$(BIN)/python -m build --outdir dist .

docs: $(VENV)/.installed-dev
	$(BIN)/python docs/site.py

test-dist: dist
	for python in $(PYTHONS); do \
	  for built in dist/*; do sh tests/nightly/packaging/installed.sh $$python $$built || exit 1; done; \
	done

demo: $(VENV)/.installed
	$(BIN)/capture-app demo --out $(OUT)

# What pytest is given for each KIND. Drivers need the machine, and are tried one suite at a time.
KIND ?= unit
CROWD := -n $(WORKERS) --dist worksteal
TEST_unit := $(CROWD) tests/unit
TEST_core := $(CROWD) $(addprefix --ignore tests/unit/,plugins companions reconstruction/methods) tests/unit
TEST_system := $(CROWD) tests/system
TEST_debian := tests/nightly/documentation/test_readme_on_bare_debian.py
TEST_nightly := $(CROWD) --ignore tests/nightly/drivers --ignore $(TEST_debian) tests/nightly
TEST_examples := $(CROWD) --hypothesis-profile new $(shell grep -rl 'from hypothesis' tests/unit tests/system --include 'test_*.py')
TEST_docs := -n auto $(wildcard tests/*/documentation)
TEST_phones := $(wildcard tests/*/companions/phones) tests/system/end_to_end/test_phones.py
TEST_v4l2 := $(wildcard tests/nightly/drivers/test_v4l2_*.py)
TEST_libcamera := tests/nightly/drivers/test_libcamera_rig.py
TEST_gige := -s tests/nightly/drivers/aravis
TEST_mixed := -s tests/nightly/drivers/mixed
TEST_windows := -s tests/nightly/drivers/windows
TEST_slurm := tests/nightly/drivers/slurm

test: $(VENV)/.installed-dev | $(filter slurm,$(KIND))
	$(BIN)/pytest $(or $(TEST_$(KIND)),$(error there is no KIND=$(KIND): see make help)) $(if $(PART),--part $(PART))

coverage: $(VENV)/.installed-dev
	mkdir -p build
	$(BIN)/pytest $(CROWD) $(addprefix --cov=capture_app/,node companions/importing session/importing session/writing sync/rig) --cov-branch \
	  --cov-report=json:build/coverage.json $(addprefix tests/unit/,companions/importing node session sync)
	$(BIN)/python -m tests.branch_coverage build/coverage.json

# What nobody packages for pip or apt-get is not there: tests/readers.txt says what is.
readers: $(VENV)/.installed-readers
$(VENV)/.installed-readers: tests/readers.txt $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -r tests/readers.txt
	@: mpl_interactions brings its own tests, under the name of ours
	rm -rf $(VENV)/lib/python3*/site-packages/tests
	npm install --silent --no-fund --no-audit --prefix $(VENV)/readers @playcanvas/splat-transform@3.7.0
	@touch $@

# The names, and what each does, are in benchmarks/benches.toml alone; some need what tests need.
bench: $(VENV)/.installed-dev
	@$(BIN)/python -m benchmarks $(NAME) $(BENCH)

PICTURES_screenshots := screenshots
PICTURES_animation := take_animation
PICTURES_calibration := calibration_pictures

pictures: $(VENV)/.installed-dev
	$(BIN)/python docs/images/$(or $(PICTURES_$(NAME)),$(error there is no NAME=$(NAME): see make help)).py

samples: $(VENV)/.installed
	$(BIN)/python -m benchmarks.samples --replace --out sample_sessions $(dir $(wildcard sample_sessions/*/recipe.json))

fuzz: $(VENV)/.installed-dev
	@$(BIN)/python -c 'import atheris' 2>/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fuzz]'
	@for reader in $${FUZZ:-$$(ls tests/fuzz/corpus)}; do \
	  echo "$$reader ..." >&2; $(BIN)/python -m tests.fuzz.run $$reader --seconds $(SECONDS) || exit 1; done

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@: text is UTF-8 on each system, which Windows does not assume
	$(BIN)/ruff check --preview --select PLW1514 capture_app reconstruction
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 capture_app/common/system/windows.py
	$(BIN)/lint-imports

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis

$(VENV)/.installed: pyproject.toml constraints.txt $(wildcard reconstruction/depth/*.c) | system
	@echo "installing into $(VENV) (once, some minutes) ..." >&2
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(RELEASES) -e '.[reconstruction,people]'
	@$(BIN)/python -m reconstruction.methods.people.blazepose_weights || echo "everything but finding people works" >&2
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(RELEASES) -e '.[dev,reconstruction,people]'
	$(BIN)/python -m compileall -q capture_app reconstruction benchmarks
	@touch $@

slurm:
	@{ [ -x /usr/sbin/slurmctld ] && [ -x /usr/sbin/munged ]; } || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing slurm-wlm and munge ..." >&2; apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge >/dev/null; \
	  else echo "no SLURM here (Debian: slurm-wlm munge), and only root can install and start it" >&2; fi; }

python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "simulshot needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
	       "Name another: make PYTHON=python3.12 ..." >&2; exit 1; }

system: | python
	@missing=""; \
	$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || missing="$$missing python3-venv"; \
	if [ "$$(uname -sm)" = "Linux x86_64" ]; then \
	  for pair in $(LIBRARIES); do \
	    PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p | grep -q "$${pair%%:*}" || missing="$$missing $${pair##*:}"; \
	  done; \
	fi; \
	if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  : Others get their C compiler from PyPI, by hatch_build.py; \
	  command -v cc >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null || missing="$$missing gcc libc6-dev"; \
	fi; \
	[ -z "$$missing" ] && exit 0; \
	if ! command -v apt-get >/dev/null; then \
	  echo "Install these system libraries first (Debian's names):$$missing" >&2; exit 1; \
	elif [ "$$(id -u)" != 0 ]; then \
	  echo "Some system libraries are missing. Type this, then make again:" >&2; \
	  echo "  sudo apt-get update && sudo apt-get install -y --no-install-recommends$$missing" >&2; exit 1; \
	fi; \
	echo "installing from Debian:$$missing" >&2; \
	apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $$missing >/dev/null
