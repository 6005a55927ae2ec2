# make demo   a recorded, estimated and scored walk, with a report
# make test   every test
# make check  style, types and layers
# make setup  system packages and the pinned environment (the others call it)

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO := runs/demo
SEED ?= 1000

.PHONY: demo test check setup clean

demo: $(READY)
	$(BIN)/stridetwin run demo --seed $(SEED) -o $(DEMO)

test: $(READY)
	$(BIN)/python -m pytest -n auto --dist loadfile

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

setup: $(READY)

$(READY): pyproject.toml constraints.txt tools/system_packages.sh
	@PYTHON="$(PYTHON)" bash tools/system_packages.sh
	@test -x $(BIN)/python || { echo "creating $(VENV)"; $(PYTHON) -m venv $(VENV); }
	@echo "installing the pinned environment into $(VENV) (about 500 MB to download the first time)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[twin,view,dev]"
	@touch $@

clean:
	rm -rf $(VENV) runs build dist ./*.egg-info
