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
# make bench NAME=sync   clock synchronization on an emulated WiFi link, beside other filters (root, 10 min; BENCH=--quick: 1 min)
# make bench NAME=relay   a rig with cameras below a relay, over two emulated WiFi links (root, 6 min)
# make bench NAME=rig   bursts of five cameras with two fast clocks, over emulated WiFi links (root, 4 min)
# make bench NAME=phones   a phone's page in a real browser over an emulated link: its clock, bursts, a kill (root, Chromium, 4 min)
# make bench NAME=record   ten minutes of recording by four cameras of 1080p30 MJPEG, 50 kills and 8 outages (30 min, 40 GB; BENCH="--seconds 60 --kills 0 --outages 0"; BENCH="--within 30 --kills 0 --outages 0": kills within it)
# make bench NAME=throughput   how many cameras a recording bears, beside ffmpeg and a plain socket (3 min; BENCH="--rig 2x30 --load 10")
# make bench NAME=folders   thirty folders of recordings as strangers have them: offset, error bar, truth and what was said (3 min; BENCH="--only lamp")
# make bench NAME=folder-layouts   three hundred drawn folders of every layout, imported and scored by what their pictures show (5 min; BENCH="--seed 2 --only parts")
# make bench NAME=panel   the time read off 200 rendered photographs of LED panels and 200 of screens, and whether its error bar holds (15 min; BENCH="--count 20")
# make bench NAME=panel-takes   forty rendered recordings aligned by a screen's panel, and whether the error bars hold (30 min; BENCH="--count 8 --jobs 4")
# make bench NAME=rig-time   the rig's time and marks of an operator, against the truth (a minute)
# make bench NAME=ball   a drawn ball's path by four cameras in step and staggered (3 min)
# make bench NAME=trajectory   the same ball's path by `reconstruct trajectory`, from whole images (8 min)
# make bench NAME=two-steps   depth and views of a rendered rig whose cameras are staggered in pairs (5 min)
# make bench NAME=stagger   errors and readiness of staggered rigs beside rigs in step, in virtual time (3 min)
# make bench NAME=multiview   depth from many views, beside SGBM (BENCH="--scene plain ..."; BENCH="--row FOLDER": real images)
# make bench NAME=views   views and splats from places without a camera, beside the truth, of four scenes (5 min a scene; BENCH="jumper --seeds 5 --splats")
# make bench NAME=left-out BENCH=SESSION   views of a session without each of its cameras, beside that camera's picture (a minute a camera)
# make bench NAME=any-rig   depth of an object by rigs of every kind: rings, a dome, opposite pairs, mixed (30 min; BENCH="--width 320")
# make bench NAME=confidence   of depths said to be right with some probability, how many are (10 min; BENCH="--pose-error 0.5")
# make bench NAME=pose-errors   depth by the error of the cameras' poses, and with --refine (15 min; BENCH="--quick --error 2")
# make bench NAME=wrong-fields   what is said of sessions calibrated with a wrong field of view, of three scenes (20 min; BENCH="crossing --error 20")
# make bench NAME=fisheyes   a board's calibration of fisheyes; their depth, views and splat beside the perspective twin's (3 min)
# make bench NAME=board-errors   errors that board calibrations state, beside the true ones (17 min; BENCH="--rigs 20")
# make bench NAME=pairs   wrong pixels of rectified pairs with a truth, beside OpenCV's SGBM (BENCH="FOLDER ...": other pairs)
# make bench NAME=people   joints of a drawn figure whose cameras are in step, late, staggered or of unequal rates (8 min; BENCH="--cameras 4")
# make bench NAME=people-scenes   who is who in drawn scenes of several people, with detections that err (5 min; BENCH="--kinds embrace --cameras 4")
# make bench NAME=people-film BENCH=SESSION   joints of a real film of which one camera is reduced to every other frame (a minute)
# make bench NAME=verdicts   what is said of takes whose lateness is known: certified, denied, not told, error bars (30 min; BENCH="--fast --part 2")
# make bench NAME=rig-verdicts   what is said of rigs of three and five cameras of which one is late (20 min; BENCH="--steady --part 2")
# make bench NAME=periodic   recordings of a motion that repeats, begun at other times: who is aligned a period off (15 min; BENCH="--count 8")
# make bench NAME=time-words   what reconstruct time says of forty takes of which single images are off, beside the truth (5 min)
# make bench NAME=seeds   ten thousand rigs in virtual time, each with the faults and orders of its seed (hours; BENCH=0-299)
# make bench NAME=flips   flip forty operators of depth, multiview and calibration, and list those that no quick test notices (an hour; BENCH="FOLDER --tests tests/unit/FOLDER")
# make bench NAME=deletions   delete each branch, handler and private body of bursts' rooms, and list those that no unit test notices (15 min; BENCH="FOLDER --tests tests/unit/FOLDER")
# make bench NAME=keys   seconds from a key to its answer on the screen, beside five live previews (a minute; BENCH="--load 8")
# make bench NAME=soak SECONDS=120   burst after burst, whether threads, memory, open files or phase errors grow, and the largest phase error (BENCH="--cameras 5 --every 20")
# make bench NAME=hostile   hostile datagrams, frames and connections against a running rig (BENCH="--datagrams 10000000 --frames 200000")
# make bench NAME=paper   the paper's tables and figures measured again, for docs/paper.md (simulated, 15 min; BENCH="--quick --out DIR")
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

# The module of each benchmark by its NAME, and its arguments; BENCH has further ones.
BENCH_sync := benchmarks.clock.sync_link
BENCH_relay := benchmarks.clock.relay_link
BENCH_rig := benchmarks.clock.rig_link
BENCH_phones := benchmarks.phones.phone_link
BENCH_record := benchmarks.sessions.recording --kills 50 --outages 8
BENCH_throughput := benchmarks.sessions.throughput
BENCH_folders := benchmarks.sessions.folders
BENCH_folder-layouts := benchmarks.sessions.folder_layouts
BENCH_panel := benchmarks.panel.read_photographs
BENCH_panel-takes := benchmarks.panel.align_takes
BENCH_rig-time := benchmarks.clock.rig_time
BENCH_ball := benchmarks.stagger.ball_path
BENCH_trajectory := benchmarks.stagger.ball_session
BENCH_two-steps := benchmarks.stagger.rendered_steps
BENCH_stagger := benchmarks.stagger.rig_errors
BENCH_multiview := benchmarks.reconstruction.multiview
BENCH_people := benchmarks.people.time_of_frames
BENCH_people-scenes := benchmarks.people.people_scenes
BENCH_people-film := benchmarks.people.every_other_frame
BENCH_views := benchmarks.reconstruction.novel_views
BENCH_left-out := benchmarks.reconstruction.left_out_cameras
BENCH_any-rig := benchmarks.reconstruction.any_rig
BENCH_confidence := benchmarks.reconstruction.depth_confidence
BENCH_pose-errors := benchmarks.reconstruction.pose_errors
BENCH_wrong-fields := benchmarks.reconstruction.wrong_fields
BENCH_fisheyes := benchmarks.reconstruction.fisheye_twin
BENCH_board-errors := benchmarks.reconstruction.board_errors
BENCH_pairs := benchmarks.reconstruction.stereo_pairs
BENCH_verdicts := benchmarks.reconstruction.verdicts
BENCH_rig-verdicts := benchmarks.reconstruction.rig_verdicts
BENCH_periodic := benchmarks.reconstruction.periodic_takes
BENCH_time-words := benchmarks.reconstruction.time_words
BENCH_seeds := tests.virtual $(if $(BENCH),,0-9999)
BENCH_flips := benchmarks.flip_operators $(if $(BENCH),,$(addprefix reconstruction/,depth methods/multiview scene/calibration) \
  --tests tests/unit/reconstruction/depth --tests tests/unit/reconstruction/scene/calibration --tests tests/unit/reconstruction)
BENCH_deletions := benchmarks.delete_parts $(if $(BENCH),,$(addprefix capture_app/,node/burst session/writing rig) \
  $(addprefix --tests tests/unit/,node session rig))
BENCH_keys := benchmarks.screen.keys
BENCH_soak := benchmarks.endurance.soak --seconds $(SECONDS)
BENCH_hostile := benchmarks.endurance.hostile
BENCH_paper := benchmarks.paper paper --markdown docs/paper.md

bench: $(VENV)/.installed$(if $(filter phones seeds flips deletions paper,$(NAME)),-dev)
	@$(BIN)/python -m $(or $(BENCH_$(NAME)),$(error there is no NAME=$(NAME): see make help)) $(BENCH)

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
