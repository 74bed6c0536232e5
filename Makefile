# The whole developer interface. Every target first builds .venv from a bare python3.11.
PY := .venv/bin/python

.PHONY: install demo test test-slow bench lint clean
install: .venv/.installed

.venv/.installed: pyproject.toml constraints.txt
	python3.11 -m venv .venv
	$(PY) -m pip install --quiet -c constraints.txt -e '.[dev]'
	$(PY) -m drake_hand.compiled
	touch $@

demo: install
	.venv/bin/drake-hand demo

# Drives keep time: what runs on the bus must not share the machine with other tests.
CLOCKED := tests/epos $(addprefix tests/cli/test_,drives_commands.py physics_in_step.py way_back.py)

test: install
	$(PY) -m pytest -n 2 $(addprefix --ignore=,$(CLOCKED))
	$(PY) -m pytest $(CLOCKED)

test-slow: install
	$(PY) -m pytest -n 2 -m slow

bench: install
	$(PY) -m pip install --quiet -c constraints.txt -e '.[dev,bench]'
	.venv/bin/drake-hand bench

lint: install
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy

clean:
	rm -rf .venv out dist build
