# The whole workspace from one place. `make help` lists the targets. Python is chosen by tools/run.sh; PYTHON=/path/to/python3 overrides it.
SHELL := /bin/sh
.DEFAULT_GOAL := help
.PHONY: help setup build test demo lint bench clean lock

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "  make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## create .venv, install the pinned packages, build, compile and warm up; seconds when nothing changed
	@sh tools/run.sh tools/setup.py setup

build:  ## build what changed in src/ (no warm-up)
	@sh tools/run.sh tools/setup.py build

demo: setup  ## the live harbour run over DDS, recorded, then a 12 h voyage offline, the report, a printed table
	@./riins demo --out out/demo

test: setup  ## ruff, mypy, every package's tests through colcon, then the whole-system tests
	@./riins exec python tools/test.py

lint: setup  ## ruff and mypy only
	@./riins exec python tools/test.py --lint

bench: setup  ## the tables of docs/results.md that need minutes
	@for script in bench/*.py; do ./riins exec python "$$script" || exit 1; done

lock:  ## make the lock files anew from tools/requirements/*.in (needs uv)
	@sh tools/lock.sh

clean:  ## remove what was built; .venv stays (remove it by hand for a fresh start)
	rm -rf build install log out .mypy_cache .ruff_cache .pytest_cache
