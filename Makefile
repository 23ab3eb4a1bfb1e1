# The two commands are `make demo` and `make test`; each builds .venv when it is missing.
# `make demo PANEL=1` plays the sample bags again and again, with the tuning panel.
PYTHON ?= python3
BIN := .venv/bin
SOURCES := $(shell find mvuav_ros executables config launch bags resource -type f 2>/dev/null) \
	setup.py setup.cfg package.xml pyproject.toml requirements/tested.txt

.PHONY: demo test test-robot lint bench report bags docs clean .venv

demo: .venv
	$(BIN)/mvuav demo $(if $(PANEL),--panel,-o out)

# First what needs no ROS graph, on all cores; then the live nodes, two tests at a time, each in
# a domain of its own, as they mostly wait; then what has a browser or a whole demo in it.
test: lint
	$(BIN)/python -m pytest -n auto --dist worksteal --ignore test/nodes --ignore test/cli/demo --ignore test/panel
	$(BIN)/python -m pytest -n 2 --dist worksteal test/nodes
	$(BIN)/python -m pytest test/cli/demo test/panel

lint: .venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: .venv
	$(BIN)/mvuav bench

# The thesis's tables and figures on synthetic flights, as one page.
report: .venv
	$(BIN)/mvuav evaluate thesis -o out/thesis --force

# The same tests, but for the longest, against the oldest libraries that a robot has: apt's of
# Ubuntu 24.04.
test-robot: .venv-robot/installed
	.venv-robot/bin/python -m pytest -n auto --dist worksteal \
		test/vision test/processing test/parameters test/recordings \
		--ignore test/vision/approach/test_simulated_flights.py

# The sample bags: synthetic flights, the same on every machine, with their truth.
bags: .venv
	$(BIN)/mvuav simulate tanker -o bags/tanker.mcap --force --frames 180 --fps 15 \
		--background sky --failures 'left_stabilizer@8-8.3' --noise 0 --detail 0.3
	$(BIN)/mvuav simulate runway -o bags/runway.mcap --force --size 320x240 --frames 150 --fps 15 \
		--motion low_pass --start-distance -20 --speed 25 --camera-pitch-deg 20 \
		--camera-rate 10 --gain-steps 0.1 --noise 0 --detail 0

# config/*.yaml and docs/parameters.md follow from the parameter dataclasses.
docs: .venv
	$(BIN)/python tools/make_parameter_files.py

.venv: .venv/installed

.venv/installed: $(SOURCES)
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' \
		|| { echo 'needs Python 3.11 to 3.13; name one with PYTHON=...'; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c requirements/tested.txt \
		'.[ros,panel,dask,test,dev]'
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --force-reinstall .
	touch $@

.venv-robot/installed: requirements/robot.txt
	$(PYTHON) -m venv --clear .venv-robot
	.venv-robot/bin/pip install --quiet --disable-pip-version-check -r requirements/robot.txt
	touch $@

clean:
	rm -rf .venv .venv-robot build install log out
