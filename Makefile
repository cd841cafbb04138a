# Every target sets itself up (.venv, editable install) and is quick the second time.
SHELL := /bin/bash
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export MUJOCO_GL ?= egl
WORKERS ?= 2
BIN := .venv/bin
ROBOT ?= g1
OUT ?= out
BENCHES ?= tick qp gait loop push stand latency calibrate estimate walk terrain

.PHONY: help demo view test test-long test-graphs test-slow check bench report report-docs docs reference clean distclean

help:  ## This text
	@sed -n 's/^\([a-z-]*\):.*##/  make \1\t/p' $(MAKEFILE_LIST) | expand -t 20

demo:  ## Stand, wave, squat, take a push and walk a square over ROS 2; report and pictures in out/
	@.ci/setup run
	@$(BIN)/poise demo --robot $(ROBOT) --out $(OUT)

view:  ## The running robot in a browser: buttons, sticks, plots, gains (start one first: poise up)
	@.ci/setup view
	@$(BIN)/poise view

test:  ## The tests, without whole graphs and those marked long or slow, in parallel processes (WORKERS=2)
	@.ci/setup dev
	@$(BIN)/python -m pytest -q -n $(WORKERS)

test-long:  ## The longer closed loops, in parallel processes
	@.ci/setup dev
	@$(BIN)/python -m pytest -q -n $(WORKERS) -m "long and not slow and not graph"

test-graphs:  ## The tests of whole graphs of processes, one at a time
	@.ci/setup dev
	@$(BIN)/python -m pytest -q -m "graph and not slow" tests/ros

test-slow:  ## The tests marked slow
	@.ci/setup dev
	$(BIN)/python -m pytest -q -m slow

check:  ## Linting, formatting, types
	@.ci/setup dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench:  ## tick, qp, gait, loop, push, stand, latency, calibrate, estimate, walk, terrain, or BENCHES='tick stairs'; JSON and plots in out/bench/
	@.ci/setup dev
	@mkdir -p $(OUT)/bench
	@status=0; for name in $(BENCHES); do \
	  $(BIN)/poise bench $$name --robot $(ROBOT) --json $(OUT)/bench/$$name-$(ROBOT).json --plot $(OUT)/bench || status=1; \
	done; exit $$status

report:  ## A few cases of every benchmark, and their report in out/bench-quick/ (minutes; it goes on where it ended)
	@.ci/setup dev
	@$(BIN)/poise bench all --quick --out $(OUT)/bench-quick

report-docs:  ## ... and what of it is committed in docs/benchmark_report/, also where a bound does not hold
	@.ci/setup dev
	@$(BIN)/poise bench all --quick --out $(OUT)/bench-quick || [ $$? -eq 1 ]
	@$(BIN)/poise bench report $(OUT)/bench-quick --docs docs/benchmark_report

docs:  ## The documentation as a site in out/site, with the reference of the Python interface; no dead link passes
	@.ci/setup dev
	@NO_MKDOCS_2_WARNING=1 PYTHONPATH=$(CURDIR) $(BIN)/mkdocs build --quiet --strict

reference:  ## docs/reference.md from what the nodes declare
	@.ci/setup dev
	@$(BIN)/python -m tests.reference

clean:  ## Remove what runs leave behind
	rm -rf $(OUT) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name .venv -prune -o \( -name '*.nb[ic]' -o -name '*.py[co]' \) -exec rm -f {} +

distclean: clean  ## ... and the environment
	rm -rf .venv
