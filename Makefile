# make demo   a recorded, estimated and scored walk, with a report
# make test   every test; with COVERAGE=1, the share of lines that they run at the end
# make check  style, types and layers
# make docs   the documentation as a site, in site/
# make wheel  wheel and source distribution, built and used in environments elsewhere, and the tutorial done there
# make setup  system packages and the pinned environment (the others call it; the demo installs what it needs alone)

PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DEMO_READY := $(VENV)/.ready-demo
INPUTS := pyproject.toml constraints.txt tools/install.sh tools/system_packages.sh
DEMO := runs/demo
SEED ?= 1000
# many processes start; each would compile all modules again where the environment forbids to keep them compiled
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test check docs wheel setup clean

demo: $(DEMO_READY)
	$(BIN)/stridetwin run demo --seed $(SEED) -o $(DEMO)

# threads of linear algebra would wait for each other: each process has one core
test: $(READY)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile \
		$(if $(COVERAGE),--cov --cov-report=)
	@$(if $(COVERAGE),echo "coverage by lines: $$($(BIN)/coverage report --format=total) %")

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

wheel: $(READY)
	$(BIN)/python -m tools.bare_environments
	$(BIN)/python -m tools.tutorial --wheel

setup: $(READY)

$(READY): $(INPUTS)
	@PYTHON="$(PYTHON)" bash tools/system_packages.sh
	@PYTHON="$(PYTHON)" VENV="$(VENV)" bash tools/install.sh twin,closed-loop,placement,view,live,docs,dev
	@touch $@ $(DEMO_READY)

$(DEMO_READY): $(INPUTS)
	@PYTHON="$(PYTHON)" bash tools/system_packages.sh
	@PYTHON="$(PYTHON)" VENV="$(VENV)" bash tools/install.sh twin,view
	@touch $@

clean:
	rm -rf $(VENV) runs site build dist ./*.egg-info
