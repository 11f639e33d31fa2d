# `make` alone lists the targets. Everything is installed into .venv inside this folder, from
# requirements.lock alone, once; a changed lock file or pyproject.toml installs again.

VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DOCS := build/docs
TOOLS := build/tools
SOURCES := docs eihrl_jax experiments notebooks tests typings
PYTHONS := python3.11 python3

.DEFAULT_GOAL := help
.PHONY: help install docs notebooks demo test test-slow fuzz soak lint typecheck format lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 12

install: $(READY) ## install everything into .venv

demo: $(READY) ## train the high level and evaluate the hierarchy in four mazes, about 3 minutes
	$(BIN)/python -m experiments.demo

test: $(READY) ## run the default tests on CPU, side by side; ARGS=-n0 one after the other
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist loadfile \
	  --no-loadscope-reorder $(ARGS)

test-slow: $(READY) ## run the tests that take minutes
	$(BIN)/python -m pytest -m "slow and not gpu" $(ARGS)

fuzz: $(READY) ## try thousands of odd mazes, maps, robots, options and policies, 15 minutes
	FUZZ=1 $(BIN)/python -m pytest -n 0 -rA -q tests/test_properties.py $(ARGS)

soak: $(READY) ## train, evaluate and step environments for an hour; memory must not grow
	$(BIN)/python -m experiments.soak $(ARGS)

lint: $(READY) ## check style
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)

typecheck: $(READY) ## check types
	$(BIN)/basedpyright

format: $(READY) ## rewrite the sources in the project's format
	$(BIN)/ruff format $(SOURCES)
	$(BIN)/ruff check --fix $(SOURCES)

docs: $(DOCS)/.ready ## build the documentation into site/, every link checked
	$(DOCS)/bin/zensical build --clean --strict

notebooks: $(READY) ## run the notebooks and keep their outputs
	$(BIN)/python notebooks/keep_outputs.py $(ARGS)

lock: $(TOOLS)/bin/uv ## write requirements.lock anew; ARGS=--upgrade takes newer versions
	$(TOOLS)/bin/uv --no-config pip compile pyproject.toml --output-file requirements.lock \
	  --extra test --extra dev --group build --universal --python-version 3.11 \
	  --generate-hashes --no-header --no-annotate --no-emit-index-url --quiet $(ARGS)
	$(TOOLS)/bin/uv --no-config pip compile --group docs --output-file requirements-docs.lock \
	  --universal --python-version 3.11 \
	  --generate-hashes --no-header --no-annotate --no-emit-index-url --quiet $(ARGS)

clean: ## remove what was installed and built; runs stay
	rm -rf $(VENV) .cache build dist site *.egg-info .pytest_cache .ruff_cache

# Makes an environment in the folder $(1) with the first Python that is new enough.
define environment
	@set -e; python=""; \
	for each in $(PYTHONS); do \
	  if $$each -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	    python=$$each; break; \
	  fi; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "error: no Python 3.11 or later: tried $(PYTHONS)" >&2; exit 2; \
	fi; \
	set -x; $$python -m venv $(1)
endef

$(READY): requirements.lock pyproject.toml
	$(call environment,$(VENV))
	$(BIN)/python -m pip install --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --disable-pip-version-check --no-deps --no-build-isolation --no-index -e .
	@touch $@

# Apart from the package's environment, which stays as small as it is.
$(DOCS)/.ready: requirements-docs.lock
	$(call environment,$(DOCS))
	$(DOCS)/bin/python -m pip install --disable-pip-version-check --require-hashes -r requirements-docs.lock
	@touch $@

$(TOOLS)/bin/uv:
	python3 -m venv $(TOOLS)
	$(TOOLS)/bin/pip install --disable-pip-version-check --quiet uv
