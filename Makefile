# make demo   capture a synchronized burst with five simulated cameras and compare it with offset frames
# make install   put capture-app and reconstruct on the PATH (EXTRAS=export,plots,pictures,rerun,cluster,gpu: those too)
# make install-capture   the same without reconstruction, for machines that only capture      make uninstall
# make test   the quick tests, in 4.5 minutes          make check   lint, types, architecture
# make test-v4l2   the rig on real camera drivers in a virtual machine (slow)
# make test-gige   three GigE Vision cameras of aravis's own making in network namespaces (root, gir1.2-aravis-0.8, gcc; 5 min)
# make test-phones   the page of phones in a real browser (Chromium)
# make test-libcamera   the rig on real libcamera and the real uvcvideo driver in a virtual machine (slow; root)
# make test-mixed   one rig of five kinds: libcamera's double, GigE Vision, a browser, a simulated phone, a recording (root, as test-gige, and Chromium)
# make test-slurm   batches on a real SLURM of this one machine (root)
# make flips   flip forty operators of depth, multiview and calibration, and list those that no quick test notices (an hour; FLIPS="FOLDER --tests tests/FOLDER")
# make test-slow   the tests of some seconds or minutes each
# make test-long   those that take up to an hour each: every step killed, every bit flipped, odd inputs, an hour held
# make test-docs   every command line of README and docs, run beside a simulated rig (some minutes)
# make test-odd-inputs   200 broken or odd calibrations and inputs through every command of reconstruct (an hour of CPU)
# make samples   render the sample sessions again from their recipes: the same bytes
# make bench-sync   clock synchronization on an emulated WiFi link, beside other filters (root, 10 min; BENCH=--quick: 1 min)
# make bench-any-rig   depth of an object by rigs of every kind: rings, a dome, opposite pairs, mixed (30 min; BENCH="--width 320")
# make bench-multiview   depth from many views, beside SGBM (BENCH="--scene plain ...")
# make bench-verdicts   what is said of takes whose lateness is known: certified, denied, not told, error bars (40 min; BENCH="--fast --part 2")
# make bench-confidence   of depths said to be right with some probability, how many are (10 min; BENCH="--pose-error 0.5")
# make bench-pairs   wrong pixels of rectified pairs with a truth, beside OpenCV's SGBM (BENCH="FOLDER ...": other pairs)
# make bench-folders   thirty folders of recordings as strangers have them: offset, error bar, truth and what was said (3 min; BENCH="--only lamp")
# make bench-panel   the time read off 200 rendered photographs of LED panels and 200 of screens, and whether its error bar holds (15 min; BENCH="--count 20")
# make bench-seeds   ten thousand rigs in virtual time, each with the faults and orders of its seed (hours; SEEDS=0-299)
# make test-crash   writers and outputs killed at every step, every bit flipped (slow)
# make bench-relay   a rig with cameras below a relay, over two emulated WiFi links (root, 6 min)
# make bench-rig   bursts of five cameras with two fast clocks, over emulated WiFi links (root, 4 min)
# make bench-record   ten minutes of recording by four cameras of 1080p30 MJPEG, replayed, 50 kills and 8 outages (30 min, 30 GB; BENCH="--seconds 60 --kills 0 --outages 0")
# make bench-phones   a phone's page in a real browser over an emulated link: its clock, bursts, a kill (root, Chromium, 4 min)
# make paper   the paper's tables and figures measured again, for docs/paper.md (simulated, 15 min; PAPER="--quick --out DIR")
# make soak SECONDS=120   burst after burst, whether threads, memory, open files or phase errors grow, and the largest phase error (SOAK="--cameras 5 --every 20")
# make hostile   hostile datagrams, frames and connections against a running rig (HOSTILE="--datagrams 10000000 --frames 200000")
# make fuzz SECONDS=120   every reader of strangers' bytes under a coverage-guided fuzzer, so many seconds each (FUZZ="datagram": that one)
# make screenshots   the pictures of the screen in docs/images, from a real run with simulated cameras
# make animation   film a take on the real screen for README, a minute or two
# make calibration-pictures   the pictures of docs/calibration.md, from the simulator (a minute)
# make wheel   a wheel of this checkout, in dist      make dist   a wheel and an sdist
# make docs   the documentation as a site, in build/site; a link or a name that leads nowhere fails
# make test-dist   wheel and sdist in clean environments, with the demo (PYTHONS="python3.11 python3.13": with these)
# make help   all targets

PYTHON ?= python3
VENV ?= .venv
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

.PHONY: help install install-capture uninstall wheel dist docs test-dist demo animation calibration-pictures screenshots samples test flips test-docs test-odd-inputs test-v4l2 test-gige test-phones test-libcamera test-mixed test-slurm test-slow test-long bench-sync bench-relay bench-rig bench-record bench-phones bench-any-rig bench-multiview bench-confidence bench-pairs bench-verdicts bench-folders bench-panel bench-seeds paper soak hostile fuzz test-crash check format python system clean
.DEFAULT_GOAL := help

help:
	@sed -n 's/^# make /make /p' Makefile

install: | system
	PYTHON=$(PYTHON) ./install.sh $(if $(EXTRAS),--with $(EXTRAS))

install-capture: | python
	PYTHON=$(PYTHON) ./install.sh --capture-only $(if $(EXTRAS),--with $(EXTRAS))

uninstall:
	./install.sh --remove

wheel: $(VENV)/.installed
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .

dist: $(VENV)/.installed-dev
	rm -rf dist
	$(BIN)/python -m build --outdir dist .

docs: $(VENV)/.installed-dev
	$(BIN)/python docs/site.py

test-dist: dist
	for python in $(PYTHONS); do \
	  for built in dist/*; do sh tests/packaging/installed.sh $$python $$built || exit 1; done; \
	done

demo: $(VENV)/.installed
	$(BIN)/capture-app demo --out $(OUT)

test: $(VENV)/.installed-dev
	$(BIN)/pytest -n $(WORKERS) --dist worksteal

test-v4l2: $(VENV)/.installed-dev
	$(BIN)/pytest -m v4l2 tests/end_to_end

test-gige: $(VENV)/.installed-dev
	$(BIN)/pytest -m gige -s tests/plugins/cameras/aravis

test-phones: $(VENV)/.installed-dev
	$(BIN)/pytest -m "slow or not slow" tests/companions/phones tests/end_to_end/test_phones.py

test-libcamera: $(VENV)/.installed-dev
	$(BIN)/pytest -m libcamera tests/end_to_end

test-mixed: $(VENV)/.installed-dev
	$(BIN)/pytest -m mixed -s tests/end_to_end/mixed

test-slurm: $(VENV)/.installed-dev
	@{ [ -x /usr/sbin/slurmctld ] && [ -x /usr/sbin/munged ]; } || { \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing slurm-wlm and munge ..." >&2; apt-get update -qq && \
	    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge >/dev/null; \
	  else echo "no SLURM here (Debian: slurm-wlm munge), and only root can install and start it" >&2; fi; }
	$(BIN)/pytest -m slurm tests/slurm

flips: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.flip_operators $(or $(FLIPS),$(addprefix reconstruction/,depth multiview calibration) \
	  --tests tests/reconstruction/depth --tests tests/reconstruction/calibration --tests tests/reconstruction)

test-slow: $(VENV)/.installed-dev
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m slow

test-docs: $(VENV)/.installed-dev
	$(BIN)/pytest -m "slow or long or not slow" -n auto tests/documentation

test-long: $(VENV)/.installed-dev
	$(BIN)/pytest -n $(WORKERS) --dist worksteal -m long

test-odd-inputs: $(VENV)/.installed-dev
	$(BIN)/pytest -m "long or not long" -n auto tests/reconstruction/commands

samples: $(VENV)/.installed
	$(BIN)/python -m benchmarks.samples --replace --out sample_sessions $(dir $(wildcard sample_sessions/*/recipe.json))

bench-sync: $(VENV)/.installed
	$(BIN)/python -m benchmarks.clock.sync_link $(BENCH)

bench-relay: $(VENV)/.installed
	$(BIN)/python -m benchmarks.clock.relay_link $(BENCH)

bench-rig: $(VENV)/.installed
	$(BIN)/python -m benchmarks.clock.rig_link $(BENCH)

bench-phones: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.phones.phone_link $(BENCH)

bench-seeds: $(VENV)/.installed-dev
	$(BIN)/python -m tests.virtual $(or $(SEEDS),0-9999)

bench-record: $(VENV)/.installed
	$(BIN)/python -m benchmarks.sessions.recording --kills 50 --outages 8 $(BENCH)

bench-any-rig: $(VENV)/.installed
	$(BIN)/python -m benchmarks.reconstruction.any_rig $(BENCH)

bench-multiview: $(VENV)/.installed
	$(BIN)/python -m benchmarks.reconstruction.multiview $(BENCH)

bench-confidence: $(VENV)/.installed
	$(BIN)/python -m benchmarks.reconstruction.depth_confidence $(BENCH)

bench-pairs: $(VENV)/.installed
	@$(BIN)/python -m benchmarks.reconstruction.stereo_pairs $(BENCH)

bench-verdicts: $(VENV)/.installed
	$(BIN)/python -m benchmarks.reconstruction.verdicts $(BENCH)

bench-folders: $(VENV)/.installed
	$(BIN)/python -m benchmarks.sessions.folders $(BENCH)

bench-panel: $(VENV)/.installed
	$(BIN)/python -m benchmarks.panel.read_photographs $(BENCH)

paper: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.paper paper --markdown docs/paper.md $(PAPER)

soak: $(VENV)/.installed
	$(BIN)/python -m benchmarks.endurance.soak --seconds $(SECONDS) $(SOAK)

hostile: $(VENV)/.installed
	$(BIN)/python -m benchmarks.endurance.hostile $(HOSTILE)

fuzz: $(VENV)/.installed-dev
	@$(BIN)/python -c 'import atheris' 2>/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[fuzz]'
	@for reader in $${FUZZ:-$$(ls tests/fuzz/corpus)}; do \
	  echo "$$reader ..." >&2; $(BIN)/python -m tests.fuzz.run $$reader --seconds $(SECONDS) || exit 1; done

calibration-pictures: $(VENV)/.installed
	$(BIN)/python docs/images/calibration_pictures.py

animation: $(VENV)/.installed-dev
	$(BIN)/python docs/images/take_animation.py

test-crash: $(VENV)/.installed-dev
	$(BIN)/pytest -m "slow or long" -n auto tests/session/writing

screenshots: $(VENV)/.installed
	$(BIN)/python docs/images/screenshots.py

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .hypothesis

$(VENV)/.installed: pyproject.toml constraints.txt $(wildcard reconstruction/depth/*.c) | system
	@echo "installing into $(VENV) (once, some minutes) ..." >&2
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[reconstruction]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,reconstruction]'
	$(BIN)/python -m compileall -q capture_app reconstruction benchmarks
	@touch $@

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
