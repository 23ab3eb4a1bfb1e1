# The two commands are `make demo` and `make test`; each builds what it needs of .venv.
PYTHON ?= python3
BIN := .venv/bin
SOURCES := $(shell find mvuav_ros mvuav_thesis executables config launch bags resource sros2 -type f \
		-not -name '*.pyc' 2>/dev/null) \
	setup.py setup.cfg package.xml pyproject.toml requirements/tested.txt tools/install.py Makefile
TOOLS := ros,panel,dask,remote,parquet,test,docs,dev

# Where Python must not leave compiled files beside the sources, each of the hundreds of processes
# of a test run would compile every library again; they are kept inside .venv instead.
ifdef PYTHONDONTWRITEBYTECODE
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(CURDIR)/.venv/pycache
endif

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast test-all test-rest test-footage test-robot lint bench report \
	bags docs docs-site docs-pictures clean .venv

help:  ## This list.
	@grep -hE '^[a-z.-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 16

demo: $(if $(PANEL),.venv/.panel,.venv/.ros)  ## Real nodes play the sample bags (PANEL=1: with the tuning panel).
	$(BIN)/mvuav demo $(if $(PANEL),--panel,-o out)

test: .venv/.tools  ## Lint, types and all tests but the longest: one summary at the end.
	@$(BIN)/python tools/run_tests.py test

test-fast: .venv/.tools  ## Lint, types, and the quick tests without a ROS graph.
	@$(BIN)/python tools/run_tests.py fast

test-rest: .venv/.tools  ## The longest tests, every Python of this machine, a robot's libraries.
	@$(BIN)/python tools/run_tests.py rest

test-all: .venv/.tools  ## test and test-rest.
	@$(BIN)/python tools/run_tests.py all

test-footage: .venv/.tools  ## Real footage that is not ours to give away: FOOTAGE=FOLDER.
	@MVUAV_FOOTAGE=$(abspath $(FOOTAGE)) $(BIN)/python tools/run_tests.py footage

test-robot: .venv/.tools  ## The library and nodes with the libraries of apt's ROS 2 Jazzy.
	@$(BIN)/python tools/run_tests.py robot

lint: .venv/.tools  ## ruff, mypy, import-linter, codespell and the prose rules.
	$(BIN)/codespell
	$(BIN)/python tools/check_prose.py
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/.tools  ## How fast it is, beside what any implementation needs.
	$(BIN)/mvuav bench

report: .venv/.ros  ## The thesis's tables and figures on synthetic flights, as one page in out/.
	$(BIN)/mvuav evaluate thesis -o out/thesis --force

# Synthetic flights, the same on every machine, with their truth.
bags: .venv/.ros  ## Make the sample bags again.
	$(BIN)/mvuav simulate tanker -o bags/tanker.mcap --force --frames 180 --fps 15 \
		--background sky --failures 'left_stabilizer@8-8.3' --noise 0 --detail 0.3
	$(BIN)/mvuav simulate runway -o bags/runway.mcap --force --size 320x240 --frames 150 --fps 15 \
		--motion low_pass --start-distance -20 --speed 25 --camera-pitch-deg 20 \
		--camera-rate 10 --gain-steps 0.1 --noise 0 --detail 0

docs: .venv/.ros  ## config/default.yaml, the SROS2 policies and the reference pages, from the code.
	$(BIN)/python sros2/make_policies.py
	$(BIN)/python tools/make_reference.py

docs-pictures: .venv/.ros  ## The documentation's pictures, from the code.
	$(BIN)/python tools/make_doc_pictures.py

docs-site: .venv/.tools  ## The documentation as a site in out/site, every warning an error.
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

.venv: .venv/.ros  ## Just the virtual environment, with mvuav and the nodes in .venv/bin.

.venv/.ros: $(SOURCES)
	@$(call install,ros)

.venv/.panel: $(SOURCES)
	@$(call install,ros$(comma)panel)

.venv/.tools: $(SOURCES)
	@$(call install,$(TOOLS))

comma := ,
# What was installed with more extras is brought up to date as well.
define install
$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' \
	|| { echo 'needs Python 3.11 to 3.13; name one with PYTHON=...'; exit 1; }
$(PYTHON) tools/install.py .venv $(1)
touch $@
endef

clean:  ## Remove everything that was built.
	rm -rf .venv .venv-* build install log out
