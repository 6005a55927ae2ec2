# make demo   a recorded, estimated and scored walk, with a report
# make test   every test
# make check  style, types and layers
# make docs   the documentation as a site, in site/
# make wheel  the wheel, built and installed elsewhere, and the tutorial done with it
# make setup  system packages and the pinned environment (the others call it)

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO := runs/demo
SEED ?= 1000

.PHONY: demo test check docs wheel setup clean

demo: $(READY)
	$(BIN)/stridetwin run demo --seed $(SEED) -o $(DEMO)

# threads of linear algebra would wait for each other: each process has one core
test: $(READY)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

wheel: $(READY)
	$(BIN)/python tools/tutorial.py --wheel

setup: $(READY)

$(READY): pyproject.toml constraints.txt tools/system_packages.sh
	@PYTHON="$(PYTHON)" bash tools/system_packages.sh
	@test -x $(BIN)/python || { echo "creating $(VENV)"; $(PYTHON) -m venv $(VENV); }
	@echo "installing the pinned environment into $(VENV) (about 500 MB to download the first time)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[twin,closed-loop,placement,view,live,docs,dev]"
	@touch $@

clean:
	rm -rf $(VENV) runs site build dist ./*.egg-info
