PYTHON_IN = .venv/bin/python
# processes that run the tests
JOBS ?= 2
.DEFAULT_GOAL := help
.PHONY: help env demo test check bench pictures schema clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' Makefile

env: .venv/.ready ## make the environment in .venv (Python packages, OpenVDB's bindings)

demo: env ## simulate a small plume, stylize it, and say where the result is
	@sh examples/plume/demo.sh out/demo

test: check ## everything that CI runs: the checks, then all tests
	$(PYTHON_IN) -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

check: env ## formatting, lint and types
	$(PYTHON_IN) -m ruff format --check .
	$(PYTHON_IN) -m ruff check .
	$(PYTHON_IN) -m mypy

bench: env ## how near stylized real smoke comes to its style (needs the data folder)
	$(PYTHON_IN) -m benchmarks.style_scores

pictures: env ## rebuild the pictures of the controls in docs/pictures (minutes, no data needed)
	$(PYTHON_IN) -m benchmarks.control_pictures

schema: env ## make the schema's generated files from schemas/usdSmoke/schema.usda
	$(PYTHON_IN) tools/generate_schema.py

clean: ## remove what was made, except the environment (that is: rm -r .venv)
	rm -rf out build dist usdsmoke.egg-info .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find usdsmoke tests examples benchmarks tools -name __pycache__ -type d -exec rm -rf {} +

# Quick when nothing changed: the stamp is newer than what it depends on.
.venv/.ready: constraints.txt pyproject.toml tools/setup_env.sh
	@sh tools/setup_env.sh
