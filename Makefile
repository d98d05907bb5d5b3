# Two commands do everything: `make run` and `make test`. Each first makes the environment in .venv.
.DEFAULT_GOAL := help
.PHONY: help run test bounds long mutants lint venv wheel screenshots docs bench results validate stress errors neighbours peers clean

# The newest Python that Taichi has wheels for; PYTHON=... overrides.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3 python; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null \
	&& echo $$p && break; done)
ifeq ($(OS),Windows_NT)
BIN := .venv/Scripts
else
BIN := .venv/bin
endif

# Where every index is checked; CI takes fewer.
BOUNDS := tests/kernels tests/contact

# Where the results of this machine are stored, which documents quote.
MACHINE ?= xeon-2-cores
RESULTS := benchmarks/results/$(MACHINE)

# The shipped scenes, for documents.
SCENES := curtain drape15 table denim net slope fast-ball veil poles responses fold stack twist tear \
	sphere flag sail hammock cape banner relief

help:
	@echo "make run    open the cloth (without a screen: render 240 frames to out/curtain)"
	@echo "make test   run all tests (REQUIRE_WINDOW=1: those of the real window may not be skipped)"
	@echo "make bounds the tests of kernels and contact with every index checked (minutes)"
	@echo "make long   the tests that take minutes, of which \`make test\` has a short form or none; writes tests/long_result.toml"
	@echo "make mutants  puts one fault after another into a copy of the program: a test must fail; writes tests/mutants_result.toml"
	@echo "             (ONLY=NAME: that one, and nothing is written)"
	@echo "make lint   ruff and mypy"
	@echo "make bench  how fast it is on this machine, beside C and JavaScript (BENCH=--full: all there is)"
	@echo "make results  the same and the goals' figures, stored in $(RESULTS), and docs/ brought up to date (MACHINE=name)"
	@echo "make validate  how far every solver is from known answers; writes docs/validation.md and docs/scenes.md (40 minutes)"
	@echo "make stress  40 cases that break cloth, every solver, ten starts a variant; writes docs/stability.md (hours; goes on)"
	@echo "make errors  time beside error: the table that --target-error reads, its pictures, docs/scene_errors.md (half an hour)"
	@echo "make neighbours  how long self-collision's search takes, beside brute force, an octree and a k-d tree"
	@echo "make peers  the same cloth in other programs, installed into environments of their own"
	@echo "make screenshots   draw the pictures in screenshots/ and docs/pictures/ anew"
	@echo "make docs   render docs/ to site/, as pages to read in a browser"

run: .venv/ready
	$(BIN)/taichi-cloth run $(SCENE)

test: .venv/tools
	$(BIN)/python -m pytest

bounds: .venv/tools
	TI_DEBUG=1 $(BIN)/python -m pytest $(BOUNDS)

# The result is written whether or not something failed; the exit status is that of the tests.
long: .venv/tools
	@mkdir -p out
	$(BIN)/python -m pytest -m long -o faulthandler_timeout=3600 --junitxml=out/long.xml; ended=$$?; \
		$(BIN)/python tests/long_result.py out/long.xml && exit $$ended

mutants: .venv/tools
	$(BIN)/python tests/mutants/run_mutants.py $(addprefix --only ,$(ONLY))

lint: .venv/tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

screenshots: .venv/tools
	$(BIN)/python screenshots/make.py
	$(BIN)/python screenshots/parameters.py
	$(BIN)/python screenshots/pages.py

# The advert that the theme prints for its successor is not wanted in every log.
docs: .venv/tools
	$(BIN)/python docs/generate.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: .venv/ready
	$(BIN)/taichi-cloth bench $(BENCH)

results: .venv/tools
	mkdir -p $(RESULTS)
	$(BIN)/taichi-cloth bench --json $(RESULTS)/bench.json --csv $(RESULTS)/bench.csv --force \
		&& $(BIN)/taichi-cloth bench --goals --json $(RESULTS)/goals.json --force; ended=$$?; \
		$(BIN)/python docs/generate.py && exit $$ended

validate: .venv/tools
	$(BIN)/taichi-cloth ablate $(SCENES) round --markdown docs/scenes.md --force \
		&& $(BIN)/taichi-cloth validate --json benchmarks/results/validation.json --markdown docs/validation.md --force; \
		ended=$$?; $(BIN)/python docs/generate.py && exit $$ended

# What is stored of the same program is not run again: a run that was broken off goes on, on another machine too, and
# each result says where it was made. The documents that quote it are brought up to date whatever the command's exit
# status, which is make's; that takes Pillow, which is among the tools.
stress: .venv/tools
	$(BIN)/taichi-cloth stress --json benchmarks/results/stability.json --resume --explain --markdown docs/stability.md --force; \
		ended=$$?; $(BIN)/python docs/generate.py && exit $$ended

# Scenes that the float64 reference does not cover; docs/scene_errors.md says why.
NO_REFERENCE := fold stack twist
errors: .venv/tools
	mkdir -p $(RESULTS)
	$(BIN)/taichi-cloth bench --error --full --csv assets/error.csv --json $(RESULTS)/error.json --plot docs/pictures --force \
		&& $(BIN)/taichi-cloth bench --error $(addprefix --scene ,$(filter-out $(NO_REFERENCE),$(SCENES) round)) \
		--json $(RESULTS)/scene_errors.json --markdown docs/scene_errors.md --force; ended=$$?; \
		$(BIN)/python docs/generate.py && exit $$ended

neighbours: .venv/tools
	$(BIN)/python benchmarks/neighbours/run.py

peers: .venv/ready
	$(BIN)/python benchmarks/peers/run.py

wheel: .venv/tools
	$(BIN)/python -m pip wheel --no-deps --wheel-dir dist .

venv: .venv/ready

.venv/python:
	@test -n "$(PYTHON)" || { echo "make: Python 3.11, 3.12 or 3.13 is needed (PYTHON=/path/to/python3.12 make run)"; exit 2; }
	$(PYTHON) -m venv .venv
	@touch $@

.venv/ready: pyproject.toml .venv/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/tools: pyproject.toml .venv/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test,dev,docs]'
	@touch .venv/ready $@

clean:
	rm -rf .venv out dist build site
